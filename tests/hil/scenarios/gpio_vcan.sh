# The operator's panel on a GPIO chip: start button, lights, and the emergency stop in every state.
# module: bench_gpio
. ./common.sh
. ./bench.sh
. ./faults.sh
. ./panel.sh
use_vcan
use_panel
start_brake /tmp/trace.csv

echo "--- a start button held at start-up"
pull $start_line 0
start_station
wait_until 10 "the held button is a fault" fault_is start-button-stuck
expect_named "$(status fault_text)" $start_line "start button"
pull $start_line 1
wait_until 5 "the fault can be cleared" clearable
clear_fault

echo "--- the start button"
expect_levels "ready" relay=0 red=0 amber=0 green=1
press_start
wait_until 5 "a start without a serial number is refused" notice_has "no serial number"
clampctl --config /tmp/station.toml next --serial HIL-NEXT --repeats 2 || fail "next"
pull $fixture_line 1
press_start
wait_until 5 "a start with an open fixture is refused" notice_has "line $fixture_line (fixture closed)"
pull $fixture_line 0
sleep 0.1
press_start
wait_until 20 "the brake is clamped" clamped
expect_levels "running" relay=1 red=0 amber=1 green=0
wait_until 30 "the check passes" verdict_is PASS
[ "$(status serial)" = HIL-NEXT ] || fail "the check is of '$(status serial)'"
expect_levels "passed" relay=0 red=0 amber=0 green=1

emergency_stop_of_running_station
emergency_stop_in_init
