# A brake that is told its speed and makes the torque by a loop of its own: a check in which no deadline is missed, also while
# earlier runs are identified beside it, its frames through `can check`, and faults, each of which ends at zero torque as fast as
# with a brake that is told its torque. That takes a disabled drive: speed zero would be torque.
. ./common.sh
. ./bench.sh
. ./faults.sh
dbc=/bench/speed_brake.dbc
can_settings='[can.mapping]
torque_command = ""
velocity_command = "BrakeCommand.VelocityCommand"'
brake_speaks_as_configured
told_speed=1

# slow_brake: its motor has a sixth of the torque that a check asks for, so that it takes up no speed as fast as it should.
slow_brake() {
  stop_brake
  brake_values="torque_limit_Nm 0.5"
  start_brake /tmp/trace.csv
  brake_values=
  wait_until 10 "the fault can be cleared" clearable
  clear_fault
  begin_fault "slow brake"
  expect_exit_code_3
  clocks=$(cause kill 0 $$)
  stop_recording
  fault=$(json_get "/tmp/$id.json" /fault)
  [ "$fault" = speed-not-followed ] || fail "$name: fault '$fault': $(json_get "/tmp/$id.json" /reason)"
  echo "ok: $name: verdict $(json_get "/tmp/$id.json" /verdict): $(json_get "/tmp/$id.json" /reason)"
  off_s=$(drive_off_command /tmp/commands.log "$clocks")
  driven_before "$off_s" || fail "$name: no torque acted when the drive was put off; this proves nothing"
  expect_zero_torque "$off_s" $zero_torque_ms
  stop_brake
  start_brake /tmp/trace.csv
  wait_until 10 "the fault can be cleared" clearable
  recover
}

# driven_before INSTANT_S: torque acted in the 10 ms before it.
driven_before() {
  awk -F, -v instant="$1" '
    NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; columns = NF; next }
    NF == columns && $at["time_s"] > instant - 0.010 && $at["time_s"] < instant && $at["torque_Nm"] != 0 { driven = 1 }
    END { exit !driven }' "$trace"
}

use_vcan
start_brake /tmp/trace.csv
start_station
wait_for_idle
healthy_check_and_its_frames 100:67E
grep -E "Brake|velocity command" /tmp/can_check
expect "can check shows the speed that the brake is told" grep -q "velocity command .*rad/s" /tmp/can_check
full_auto_check
plant_lost
scripted_fault corrupt-crc
scripted_fault frozen-counter
scripted_fault impossible-values
slow_brake
station_killed
