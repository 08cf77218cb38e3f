# A brake that sends and wants frames every half of a millisecond, over CAN FD: a check in which no deadline is missed, also
# while earlier runs are identified beside it, and faults, each of which ends at zero torque as fast as at one kilohertz.
. ./common.sh
. ./bench.sh
. ./faults.sh
dbc=/bench/brake_fd.dbc
can_settings='data_bitrate = 4000000
feedback_cycle_ms = 0.5
command_cycle_ms = 0.5
[can.protection]
checksum = "e2e-7"
[can.mapping]
torque_command = "Command.Torque"
enable = "Command.Enable"
force = "Feedback.Force"
velocity = "Feedback.Velocity"
torque = "Feedback.Torque"
position = "Feedback.Position"
sample_clock = "Feedback.Clock"
enabled = ""
watchdog = "Feedback.Watchdog"
fault = "Feedback.Fault"
counter = "Counter"
crc = "Crc"'
printf '[can]\ndbc = "%s"\n%s\n' $dbc "$can_settings" >/tmp/frames.toml
brake_frames="--station /tmp/frames.toml"

expect "vcan0 exists" ip link add dev vcan0 type vcan
ip link set vcan0 mtu 72
expect "vcan0 is up for CAN FD" bring_up vcan0
station_interface=vcan0
brake_interface=vcan0
samples_per_s=2000
# The loops leave less of the one processor for the command: it may begin later, and still meet the brake driven.
check_lead_s=0.08
start_brake /tmp/trace.csv
start_station
wait_for_idle
candump -L vcan0,100:67F >/tmp/frames.log &
log_pid=$!
measure_approach
kill $log_pid
clampctl --config /tmp/station.toml can check /tmp/frames.log >/tmp/can_check 2>&1 || fail "can check: $(cat /tmp/can_check)"
expect "can check understands the brake" grep -q "understands this brake" /tmp/can_check
grep -E "every|Command|Feedback" /tmp/can_check
skipped_before=$(status skipped)
check full auto
expect_pass full
cat /tmp/full.out
echo "timing: $(json_get /tmp/full.json /timing)"
expect "no period skipped" [ "$(json_get /tmp/full.json /timing/skipped)" = 0 ]
expect "no grid point skipped" [ "$(status skipped)" = "$skipped_before" ]
expect "no sample lost" [ "$(json_get /tmp/full.json /timing/lost_samples)" = 0 ]
expect_close_to_truth full
fault "plant killed" 'cause kill 9 $brake_pid' 'start_brake /tmp/trace_2.csv'
brake_resumes=1
fault "plant stopped" 'cause kill 19 $brake_pid' 'cause kill 18 $brake_pid'
brake_resumes=0
scripted_fault corrupt-crc
scripted_fault frozen-counter
scripted_fault impossible-values
