# The operator's panel in a check: the fixture opens, lines and chip vanish, and the relay drops whatever becomes of the
# station.
# module: bench_gpio
. ./common.sh
. ./bench.sh
. ./faults.sh
. ./panel.sh
use_vcan
use_panel
start_brake /tmp/trace.csv
start_station
wait_for_idle

panel_fault "fixture opened" fixture-open $fixture_line "fixture closed" \
  "cause write $chip/pull '$fixture_line 1'" "pull $fixture_line 0" 25
panel_fault "line unreadable" interlock-lost $stop_line "emergency stop" \
  "cause write $chip/broken $((1 << stop_line))" "echo 0 >$chip/broken" 5
chip_removed
relay_guard_stopped
station_stopped
station_killed_with_relay
relay_guard_killed
