# A brake that sends no clock: the station finds its sampling instants from when the frames arrive. A check, its frames
# through `can check`, and faults, each of which ends at zero torque as fast as with a clock.
. ./common.sh
. ./bench.sh
. ./faults.sh
can_settings='[can.mapping]
sample_clock = ""'
brake_speaks_as_configured

use_vcan
start_brake /tmp/trace.csv
start_station
wait_for_idle
healthy_check_and_its_frames 180:7FC
grep "times are told by the arrivals" /tmp/can_check || fail "can check says nothing of the arrivals"
check full 8
expect_pass full
expect_on_time full
plant_lost
scripted_fault corrupt-crc
scripted_fault frozen-counter
scripted_fault impossible-values
