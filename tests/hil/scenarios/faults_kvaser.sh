# Faults of a real controller's driver: each ends at zero torque, verdict ERROR and exit code 3, and the station recovers
# without a restart. Here the station falls silent and the brake's own watchdog has to act.
# qemu: -object can-bus,id=bus0 -device kvaser_pci,canbus=bus0,addr=4 -device kvaser_pci,canbus=bus0,addr=5
. ./common.sh
. ./bench.sh
. ./faults.sh
use_kvaser
start_brake /tmp/trace.csv
start_station
wait_for_idle

driver=/sys/bus/pci/drivers/kvaser_pci
rebind() { echo 0000:00:04.0 >$driver/bind && bring_up can0; }

fault "interface down" 'cause link can0 down' 'bring_up can0' $silent_station_ms
fault "controller unbound" 'cause write $driver/unbind 0000:00:04.0' rebind $silent_station_ms
fault "plant killed" 'cause kill 9 $brake_pid' 'start_brake /tmp/trace_2.csv'
station_killed
