# The operator's panel in front of the bench's own GPIO chip: sourced after faults.sh. The contacts close to ground: a
# line at 1 is an open contact.

readonly chip=/sys/devices/platform/bench-gpio
readonly driver=/sys/bus/platform/drivers/bench-gpio
readonly stop_line=0 fixture_line=1 start_line=2 relay_line=3 red_line=4 amber_line=5 green_line=6
readonly two_ticks_ms=2

use_panel() {
  [ -e $chip/levels ] || fail "there is no GPIO chip"
  # The kernel has words for a chip that is removed, and printing them on the console stops everything for milliseconds.
  dmesg -n 1
  pull $start_line 1
  station_tables=$panel_table
}

readonly panel_table="[gpio]
chip = \"bench-gpio\"
emergency_stop = { line = $stop_line, active = \"low\", bias = \"pull-up\" }
fixture_closed = { line = $fixture_line, active = \"low\", bias = \"pull-up\" }
start_button = { line = $start_line, active = \"low\", bias = \"pull-up\" }
enable_relay = { line = $relay_line }
light_red = { line = $red_line }
light_amber = { line = $amber_line }
light_green = { line = $green_line }
"

# pull LINE LEVEL
pull() { echo "$1 $2" >$chip/pull || fail "cannot pull line $1"; }

level() { cut -c $(($1 + 1)) $chip/levels; }

press_start() {
  pull $start_line 0
  sleep 0.1
  pull $start_line 1
  sleep 0.1
}

# expect_levels WHEN NAME=LEVEL...: outputs, after the panel had time to set them.
expect_levels() {
  when=$1
  shift
  sleep 0.05
  for wanted in "$@"; do
    eval "line=\$${wanted%=*}_line"
    [ "$(level $line)" = "${wanted#*=}" ] || fail "$when: ${wanted%=*} is not ${wanted#*=} (levels $(cat $chip/levels))"
  done
  echo "ok: $when: $*"
}

notice_has() { status notice | grep -qF "$1"; }
fault_is() { [ "$(status fault)" = "$1" ]; }
verdict_is() { [ "$(status last_verdict)" = "$1" ]; }

# expect_named TEXT LINE ROLE
expect_named() {
  case $1 in
    *"line $2 ($3)"*) echo "ok: named: $1" ;;
    *) fail "'$1' does not name line $2 ($3)" ;;
  esac
}

# drive_after LOG CAUSE_S: milliseconds from the cause to the last command that enabled the drive, and whether one did in
# the 10 ms before. In the frame BrakeCommand Enable is the lowest bit of the third byte.
drive_after() {
  awk -v cause="$2" '
    {
      if (index("13579BDF", substr($3, 10, 1)) == 0) next
      time = substr($1, 2) + 0
      if (time > cause) last = time
      else if (time > cause - 0.010) before = 1
    }
    END { printf "%.3f %d\n", last ? (last - cause) * 1000 : 0, before }' "$1"
}

# expect_end_of_drive CLOCKS LIMIT-MS DRIVEN: on the bus, as candump saw it.
expect_end_of_drive() {
  stop_recording
  drive_after /tmp/commands.log "${1#* }" >/tmp/drive_after
  read -r after_ms driven_before </tmp/drive_after
  [ "$driven_before" = "$3" ] || fail "$name: the drive was enabled before: $driven_before instead of $3"
  at_most "$name: the last command that enables the drive, ms after the cause" "$after_ms" "$2"
}

# expect_record EXIT-CODE VERDICT FAULT LINE ROLE: of the check under way.
expect_record() {
  code=0
  wait $check_pid || code=$?
  [ $code = "$1" ] || { cat "/tmp/$id.out"; tail -n 5 /tmp/station.log; fail "$name: exit code $code instead of $1"; }
  [ "$(json_get "/tmp/$id.json" /verdict)" = "$2" ] || fail "$name: verdict $(json_get "/tmp/$id.json" /verdict)"
  [ "$(json_get "/tmp/$id.json" /fault)" = "$3" ] || fail "$name: fault $(json_get "/tmp/$id.json" /fault)"
  expect_named "$(json_get "/tmp/$id.json" /reason)" "$4" "$5"
}

press_stop="cause write $chip/pull '$stop_line 1'"

release_stop() {
  clampctl --config /tmp/station.toml clear >/tmp/clear.out 2>&1 && fail "$name: cleared while the button is pressed"
  pull $stop_line 0
  wait_until 10 "the fault can be cleared" clearable
  clear_fault
}

# emergency_stop_in STATE WHEN: WHEN is a command that succeeds when the state is reached, or at-enable.
emergency_stop_in() {
  if [ "$2" = at-enable ]; then
    # The check's first enabling command is ARMED's; ten ticks later it would run.
    cause at-enable $station_interface write $chip/pull "$stop_line 1" >/tmp/clocks &
    presser_pid=$!
    sleep 0.1
    begin_fault "emergency stop in $1"
    wait $presser_pid || fail "$name: cannot press"
    clocks=$(cat /tmp/clocks)
  else
    begin_fault "emergency stop in $1"
    wait_until 30 "the state $1" $2
    clocks=$(eval "$press_stop") || fail "$name: cannot press"
  fi
  expect_record 4 ABORTED emergency-stop $stop_line "emergency stop"
  expect_end_of_drive "$clocks" $two_ticks_ms 1
  expect "$name: it was in $1" stopped_in "$1"
  expect_levels "$name" relay=0
  torque_after "$trace" "${clocks% *}" >/tmp/torque_after
  read -r after_ms </tmp/torque_after
  at_most "$name: end of the brake's torque, ms after the cause" "$after_ms" $zero_torque_ms
  release_stop
}

# As the station logs it, which is quicker to ask than the station itself: RELEASING lasts 0.2 s.
releasing() { tail -n 1 /tmp/station.log | grep -q "station is RELEASING"; }

stopped_in() { [ "$(status fault_state)" = "$1" ]; }

record_commands() {
  name=$1
  echo "--- $name"
  chrt -f 1 candump -D -L "$station_interface,100:7FF" >/tmp/commands.log 2>/dev/null &
  candump_pid=$!
  sleep 0.1
}

emergency_stop_idle() {
  record_commands "emergency stop in IDLE"
  clocks=$(eval "$press_stop")
  wait_until 5 "the emergency stop is a fault" fault_is emergency-stop
  expect_end_of_drive "$clocks" 0 0
  expect_named "$(status fault_text)" $stop_line "emergency stop"
  release_stop
}

emergency_stop_in_fault() {
  pull $stop_line 1
  wait_until 5 "the emergency stop is a fault" fault_is emergency-stop
  pull $stop_line 0
  wait_until 5 "the fault can be cleared" clearable
  record_commands "emergency stop in FAULT"
  clocks=$(eval "$press_stop")
  sleep 0.2
  expect_end_of_drive "$clocks" 0 0
  release_stop
}

# In every state but INIT, which needs another start.
emergency_stop_of_running_station() {
  emergency_stop_in ARMED at-enable
  emergency_stop_in RUNNING clamped
  fault_repeats=2
  emergency_stop_in RELEASING releasing
  fault_repeats=20
  emergency_stop_idle
  emergency_stop_in_fault
}

emergency_stop_in_init() {
  stop_brake
  wait_until 5 "the silent brake is a fault" fault_is feedback-stale
  stop_station
  record_commands "emergency stop in INIT"
  start_station
  wait_until 5 "the station is in INIT" station_is INIT
  clocks=$(eval "$press_stop")
  wait_until 1 "the emergency stop is a fault" fault_is emergency-stop
  expect_end_of_drive "$clocks" 0 0
  start_brake /tmp/trace_init.csv
  release_stop
}

# panel_fault NAME FAULT LINE ROLE CAUSE REMOVAL LIMIT-MS: in a check, on the clamped brake.
panel_fault() {
  begin_fault "$1"
  wait_until 20 "the brake is clamped" clamped
  clocks=$(eval "$5") || fail "$name: cannot cause it"
  expect_record 3 ERROR "$2" "$3" "$4"
  expect_end_of_drive "$clocks" "$7" 1
  expect_levels "$name" relay=0
  eval "$6" || fail "$name: cannot remove the cause"
  wait_until 10 "the fault can be cleared" clearable
  clear_fault
}

lines_pulled_in_a_check() {
  panel_fault "fixture opened" fixture-open $fixture_line "fixture closed" \
    "cause write $chip/pull '$fixture_line 1'" "pull $fixture_line 0" 25
  panel_fault "line unreadable" interlock-lost $stop_line "emergency stop" \
    "cause write $chip/broken $((1 << stop_line))" "echo 0 >$chip/broken" 5
}

# Linux 6.1 warns at length when a chip goes whose interrupts are in use, and holds the processor for it: the first cause
# that the loop sees may be another's silence. The lines that are lost show in the status all the same.
chip_removed() {
  name="chip removed"
  echo "--- $name"
  echo bench-gpio >$driver/unbind
  wait_until 5 "the removed chip is a fault" station_is FAULT
  expect "$name: the emergency stop is lost" [ "$(status panel/0/state)" = lost ]
  expect_named "$(status panel/0/line)" $stop_line "emergency stop"
  sleep 0.2
  [ "$(status clearable)" = false ] || fail "$name: the fault could be cleared without the chip"
  echo bench-gpio >$driver/bind
  pull $start_line 1
  wait_until 10 "the fault can be cleared" clearable
  clear_fault
  expect_levels "$name and put back" relay=0
}

find_guard() {
  guard_pid=$(grep -lx clampd-relay /proc/[0-9]*/comm 2>/dev/null | cut -d/ -f3)
  [ -n "$guard_pid" ]
}

relay_guard_stopped() {
  begin_fault "relay's guard stopped"
  wait_until 20 "the brake is clamped" clamped
  find_guard || fail "the relay has no guard"
  clocks=$(cause kill 19 "$guard_pid") # stopped, it cannot drop the relay: the drive must go by itself
  expect_record 3 ERROR interlock-lost $relay_line "enable relay"
  expect_end_of_drive "$clocks" 30 1
  kill -18 "$guard_pid"
  wait_until 10 "the fault can be cleared" clearable
  expect_levels "$name" relay=0
  clear_fault
}

# The last scene: the station needs a restart then. Here, where the brake runs on the same processor, the kernel's tidying
# up after the guard keeps it silent for milliseconds, and that may be the first cause.
relay_guard_killed() {
  begin_fault "relay's guard killed"
  wait_until 20 "the brake is clamped" clamped
  [ "$(level $relay_line)" = 1 ] || fail "$name: the relay was not energised"
  find_guard || fail "the relay has no guard"
  clocks=$(cause kill 9 "$guard_pid")
  expect_exit_code_3
  expect_end_of_drive "$clocks" 30 1
  expect_levels "$name" relay=0
  expect "$name: the relay is lost" [ "$(status panel/3/state)" = lost ]
  expect_named "$(status panel/3/line)" $relay_line "enable relay"
}

# expect_relay_drops CAUSE...
expect_relay_drops() {
  [ "$(level $relay_line)" = 1 ] || fail "$name: the relay was not energised"
  "$@"
  sleep 0.03
  [ "$(level $relay_line)" = 0 ] || fail "$name: the relay still holds after 30 ms"
  echo "ok: $name: the relay dropped within 30 ms"
}

# Every thread of the station stands still, and its last command stays on the brake for the brake's own 20 ms.
station_stopped() {
  begin_fault "station stopped"
  wait_until 20 "the brake is clamped" clamped
  expect_relay_drops kill -19 $station_pid
  sleep 0.5
  kill -18 $station_pid
  code=0
  wait $check_pid || code=$?
  [ $code = 3 ] || fail "$name: exit code $code instead of 3"
  stop_recording
  wait_until 10 "the fault can be cleared" clearable
  expect_levels "$name" relay=0
  clear_fault
}

station_killed_with_relay() {
  begin_fault "station killed"
  wait_until 20 "the brake is clamped" clamped
  expect_relay_drops kill -9 $station_pid
  wait $station_pid
  stop_recording
  code=0
  wait $check_pid || code=$?
  [ $code = 3 ] || fail "$name: exit code $code instead of 3"
  find_guard && fail "$name: the guard outlived its work"
  start_station
  wait_for_idle
  check "$id" 2
  expect_pass "$id"
}
