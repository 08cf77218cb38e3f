# A brake that sends and wants frames every half of a millisecond, over CAN FD: a check in which no deadline is missed, also
# while earlier runs are identified beside it, and faults, each of which ends at zero torque as fast as at one kilohertz.
. ./common.sh
. ./bench.sh
. ./faults.sh
dbc=/bench/brake_fd.dbc
can_settings='data_bitrate = 4000000
feedback_cycle_ms = 0.5
command_cycle_ms = 0.5
'"$(cat brake_fd.toml)"
brake_speaks_as_configured

expect "vcan0 exists" ip link add dev vcan0 type vcan
ip link set vcan0 mtu 72
expect "vcan0 is up for CAN FD" bring_up vcan0
station_interface=vcan0
brake_interface=vcan0
samples_per_s=2000
start_brake /tmp/trace.csv
start_station
wait_for_idle
healthy_check_and_its_frames 100:67F
grep -E "every|Command|Feedback" /tmp/can_check
full_auto_check
plant_lost
scripted_fault corrupt-crc
scripted_fault frozen-counter
scripted_fault impossible-values
