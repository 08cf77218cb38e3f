# No single wrong reading harms, over a virtual CAN: in each check one reading of the brake lies from a random instant on, in
# frames that are right. The true brake stays within its limits, its torque ends with the station's fault, the reason names
# the reading, and no verdict rests on it. The same campaign with an embedded brake, in thousands, is
# tests/scenario/reading_campaign.cpp.
#
# environment: CLAMPD_SPOILED_READINGS
# environment: CLAMPD_SPOILED_FIRST
. ./common.sh
. ./bench.sh
. ./faults.sh
. ./spoiled.sh
use_vcan
# Short, but twice as long as the station needs to learn the readings' noise. What no fault ends is judged by its estimate: the
# search for its cause takes minutes on an emulated processor.
station_tables='[check]
tare_s = 0.1
diagnose = false'
start_brake /tmp/trace.csv
start_station
wait_for_idle
healthy_check

spoiled_reading encoder frozen reading
spoiled_reading velocity negated velocity
spoiled_reading force silent force

measure_check
spoiled_campaign "${CLAMPD_SPOILED_READINGS:-6}" "${CLAMPD_SPOILED_FIRST:-1}"

start_brake /tmp/trace.csv
wait_until 10 "the fault can be cleared" clearable
clear_fault
check last 20
expect_pass last
expect_close_to_truth last
echo "ok: the same station passes a healthy brake"
