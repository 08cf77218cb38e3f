# Faults in the middle of a check: sourced after bench.sh.
#
# Two witnesses, neither of them the station: the brake's trace of the torque that really acted, and the command frames
# as candump saw them (all that is left of a brake that was killed). Both must have been driving when the cause came.

readonly zero_torque_ms=${zero_torque_ms:-5}
readonly silent_station_ms=21 # the brake's watchdog of 20 ms, and the sample in which it acts

# fault NAME CAUSE REMOVAL [BRAKE-LIMIT-MS]: CAUSE and REMOVAL are commands; CAUSE prints the clocks as cause.cpp does.
# brake_resumes=1 for a brake that was stopped: its own time stands still until the removal.
fault() {
  begin_fault "$1"
  wait_until 20 "the brake is clamped" clamped
  clocks=$(eval "$2") || fail "$1: cannot cause it"
  expect_error "$clocks"
  eval "$3" >/tmp/removal || fail "$1: cannot remove the cause"
  if [ "${brake_resumes:-0}" = 1 ]; then clocks=$(cat /tmp/removal); fi
  wait_until 10 "the fault can be cleared" clearable
  expect_zero_torque "${clocks% *}" "${4:-$zero_torque_ms}"
  recover
}

# When the brake misbehaves by itself: so many seconds after it is clamped by so much, however long that takes the check.
readonly scripted_force_N=12000
readonly scripted_delay_s=0.02
scripted_times="at_s = $scripted_delay_s
duration_s = 0.3
from_force_N = $scripted_force_N"

# scripted_fault KIND [LIMIT-MS]: the brake misbehaves by itself as soon as it is clamped.
scripted_fault() {
  stop_brake
  brake_tables=$(printf '[[fault]]\nkind = "%s"\n%s' "$1" "$scripted_times")
  start_brake /tmp/trace.csv
  brake_tables=
  expect_scripted "$1" "${2:-$zero_torque_ms}"
}

# expect_scripted NAME LIMIT-MS [WORD]: a check meets the misbehaviour of a brake with $scripted_times. WORD must stand in the
# reason.
expect_scripted() {
  wait_until 10 "the fault can be cleared" clearable
  clear_fault
  begin_fault "$1"
  end_of_check
  cause_s=$(scripted_cause_s "$trace")
  [ -n "$cause_s" ] || fail "$name: the brake was never clamped: $(cat "/tmp/$id.out")"
  clocks=$(cause kill 0 $$)
  clocks="$cause_s $(echo "$clocks" | awk -v cause="$cause_s" '{ printf "%.6f", $2 - $1 + cause }')"
  expect_error "$clocks" "$2"
  case $reason in
    *"${3:-}"*) ;;
    *) fail "$name: the reason does not name $3: $reason" ;;
  esac
  wait_until 10 "the fault can be cleared" clearable
  expect_zero_torque "$cause_s" "$2"
  recover
}

# The station dies: only the brake's watchdog is left, and a new station takes over.
station_killed() {
  begin_fault "station killed"
  wait_until 20 "the brake is clamped" clamped
  clocks=$(cause kill 9 $station_pid)
  wait $station_pid
  expect_exit_code_3
  sleep 0.2
  expect_zero_torque "${clocks% *}" $silent_station_ms
  stop_recording
  start_station
  wait_for_idle
  check "$id" 2
  expect_pass "$id"
  echo "ok: $name: a new station checks the brake"
}

# Time, by the station's clock, of the sample with which the misbehaviour begins. Counted in samples, since the brake falls
# behind where the guest's one processor held it up.
scripted_cause_s() {
  awk -F, -v force=$scripted_force_N -v samples="$(awk -v rate="${samples_per_s:-1000}" -v delay=$scripted_delay_s 'BEGIN { print delay * rate }')" '
    NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; next }
    !clamped && $at["force_N"] > force { clamped = NR }
    clamped && NR >= clamped + samples { print $at["time_s"]; exit }' "$1"
}

# As many repeats as the brake needs, identified beside the loop.
full_auto_check() {
  skipped_before=$(status skipped)
  check full auto
  expect_pass full
  cat /tmp/full.out
  expect_on_time full
  expect "no grid point skipped" [ "$(status skipped)" = "$skipped_before" ]
  expect_close_to_truth full
}

# Before anything is spoiled.
healthy_check() {
  id=healthy
  check healthy 2
  expect_pass healthy
  echo "ok: a healthy check passes"
}

# healthy_check_and_its_frames FILTER: and `can check` understands the frames that pass in the meantime.
healthy_check_and_its_frames() {
  candump -L "vcan0,$1" >/tmp/frames.log &
  log_pid=$!
  healthy_check
  kill $log_pid
  clampctl --config /tmp/station.toml can check /tmp/frames.log >/tmp/can_check 2>&1 || fail "can check: $(cat /tmp/can_check)"
  expect "can check understands the brake" grep -q "understands this brake" /tmp/can_check
}

# The brake dies and is started anew; it stands still and goes on.
plant_lost() {
  fault "plant killed" 'cause kill 9 $brake_pid' 'start_brake /tmp/trace_2.csv'
  brake_resumes=1
  fault "plant stopped" 'cause kill 19 $brake_pid' 'cause kill 18 $brake_pid'
  brake_resumes=0
}

begin_fault() {
  name=$1
  id=$(echo "$name" | tr ' ' '_')
  echo "--- $name"
  faulty_trace=$trace
  # Above every ordinary process: a witness that waits for the processor when it is told to end loses what it has not read.
  chrt -f 1 candump -D -L "$brake_interface,100:7FF" >/tmp/commands.log 2>/dev/null &
  candump_pid=$!
  timeout "${check_timeout_s:-60}" clampctl --config /tmp/station.toml run --serial HIL-1 \
    --repeats ${fault_repeats:-20} --json "/tmp/$id.json" >"/tmp/$id.out" 2>&1 &
  check_pid=$!
}

stop_recording() {
  kill $candump_pid 2>/dev/null
  wait $candump_pid
}

# expect_error CLOCKS [LIMIT-MS]: what clampctl says, and that the station asked for no torque soon after the cause.
expect_error() {
  expect_exit_code_3
  verdict=$(json_get "/tmp/$id.json" /verdict)
  reason=$(json_get "/tmp/$id.json" /reason)
  [ "$verdict" = ERROR ] || fail "$name: verdict '$verdict': $reason"
  echo "ok: $name: verdict ERROR: $reason"
  stop_recording
  command_after /tmp/commands.log "${1#* }" >/tmp/command_after
  read -r after_ms driven_before </tmp/command_after
  [ "$driven_before" = 1 ] || fail "$name: no torque was asked for when the cause came; this proves nothing"
  at_most "$name: the station's last command for torque, ms after the cause" "$after_ms" "${2:-$zero_torque_ms}"
}

# Waits for the check that begin_fault began; leaves its exit code in $check_code.
end_of_check() {
  [ -n "$check_pid" ] || return 0
  check_code=0
  wait $check_pid || check_code=$?
  check_pid=
}

expect_exit_code_3() {
  end_of_check
  [ $check_code = 3 ] && return
  cat "/tmp/$id.out"
  tail -n 5 /tmp/station.log
  fail "$name: exit code $check_code instead of 3"
}

expect_zero_torque() {
  torque_after "$faulty_trace" "$1" >/tmp/torque_after
  read -r after_ms </tmp/torque_after
  at_most "$name: end of the brake's torque, ms after the cause" "$after_ms" "$2"
}

recover() {
  clear_fault
  check "$id" 2
  expect_pass "$id"
  kill -0 $station_pid || fail "$name: the station is gone"
  echo "ok: $name: after a clear the same station passes the brake"
}

clearable() { [ "$(status clearable)" = true ]; }

clear_fault() {
  clampctl --config /tmp/station.toml clear >/tmp/clear.out 2>&1 || fail "clear: $(cat /tmp/clear.out)"
  wait_for_idle
}

# later_than SUMMAND...: CLOCK_MONOTONIC has passed their sum.
later_than() {
  echo "$@" | awk -v now="$(cut -d' ' -f1 /proc/uptime)" '{ for (i = 1; i <= NF; i++) sum += $i } END { exit !(now > sum) }'
}

# By the end of its trace the brake is clamped and driven. The columns are found by their names.
clamped() {
  tail -n 3 "$trace" | awk -F, -v columns="$(head -n 1 "$trace")" '
    BEGIN { n = split(columns, name, ","); for (i = 1; i <= n; i++) at[name[i]] = i }
    NF == n { force = $at["force_N"]; torque = $at["torque_Nm"] }
    END { exit !(force > 8000 && (torque > 0.2 || torque < -0.2)) }'
}

# torque_after TRACE CAUSE_S: milliseconds from the cause to the end of the last sample that drove the motor.
torque_after() {
  awk -F, -v cause="$2" '
    NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; columns = NF; next }
    NF == columns {
      if (driven && $at["time_s"] > cause) last = $at["time_s"]
      driven = $at["torque_Nm"] != 0 && $at["time_s"] > cause - 0.1
    }
    END { printf "%.3f\n", last ? (last - cause) * 1000 : 0 }' "$1"
}

# command_after LOG CAUSE_S: milliseconds from the cause to the last frame that asked for torque, and whether one did in
# the $command_window_s (10 ms) before. In the command frame torque is the first two bytes, Enable the lowest bit of the third. With told_speed=1
# the first two are a speed, and only a disabled drive is asked for no torque: speed zero would be torque.
command_after() {
  awk -v cause="$2" -v told_speed="${told_speed:-0}" -v before_s="${command_window_s:-0.010}" '
    {
      time = substr($1, 2) + 0
      data = substr($3, 5)
      sub(/^#./, "", data) # CAN FD: "100##1..."
      if (substr(data, 5, 2) == "00" || (!told_speed && substr(data, 1, 4) == "0000")) next
      if (time > cause) last = time
      else if (time > cause - before_s) before = 1
    }
    END { printf "%.3f %d\n", last ? (last - cause) * 1000 : 0, before }' "$1"
}

# milliseconds FROM_S TO_S
milliseconds() { awk -v from="$1" -v to="$2" 'BEGIN { printf "%.1f\n", (to - from) * 1000 }'; }

# drive_off_command LOG CLOCKS: when the first command after the last that enables the drive went out, in monotonic time.
# Enable is as in command_after.
drive_off_command() {
  awk -v monotonic="${2% *}" -v realtime="${2#* }" '
    index("13579BDF", substr($3, 10, 1)) { enabled = 1; next }
    enabled { off = substr($1, 2) + 0; enabled = 0 }
    END { printf "%.6f\n", off - realtime + monotonic }' "$1"
}
