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

lines_pulled_in_a_check
chip_removed
relay_guard_stopped
station_stopped
station_killed_with_relay
relay_guard_killed
