# Faults over a virtual CAN: each ends at zero torque, verdict ERROR and exit code 3, and the station recovers without
# a restart. Station and brake share vcan0, so taking it down takes it from both: no command reaches the brake from then
# on, while the kernel still takes its frames for 10 ms (it waits for its readers before it calls the interface down).
# So the brake knows nothing but a silent station.
. ./common.sh
. ./bench.sh
. ./faults.sh
use_vcan
start_brake /tmp/trace.csv
start_station
wait_for_idle
healthy_check

plant_lost
fault "interface down" 'cause link vcan0 down' 'bring_up vcan0' $silent_station_ms
fault "bus-off frame" 'cause frame vcan0 20000040#0000000000000000' true
scripted_fault corrupt-crc
scripted_fault frozen-counter
scripted_fault impossible-values
station_killed
