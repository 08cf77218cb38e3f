# A brake that sends readings and wants commands every 5 ms: a check in which no deadline is missed, also while earlier runs are
# identified beside it, its frames through `can check`, and faults, each of which ends at zero torque within as many periods as at
# one kilohertz.
zero_torque_ms=25
command_window_s=0.011
samples_per_s=200
. ./common.sh
. ./bench.sh
. ./faults.sh
can_settings='feedback_cycle_ms = 5
command_cycle_ms = 5'
brake_speaks_as_configured

use_vcan
start_brake /tmp/trace.csv
start_station
wait_for_idle
healthy_check_and_its_frames 180:7FC
grep "every 5" /tmp/can_check || fail "can check does not see how often the frames come"
full_auto_check
plant_lost
fault "interface down" 'cause link vcan0 down' 'bring_up vcan0'
scripted_fault corrupt-crc
scripted_fault frozen-counter
scripted_fault impossible-values
station_killed
