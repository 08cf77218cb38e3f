# A brake that neither sends a clock nor counts its samples: the station finds its sampling instants from when the frames
# arrive, and frames that come again and again by what the readings then contradict. A check, its frames through `can check`,
# and faults.
. ./common.sh
. ./bench.sh
. ./faults.sh
can_settings='[can.mapping]
sample_clock = ""
counter = ""'
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
# Nothing in the frames tells that they are old: the readings do, as soon as they contradict what the drive was told.
scripted_fault frozen-counter 15
scripted_fault impossible-values
