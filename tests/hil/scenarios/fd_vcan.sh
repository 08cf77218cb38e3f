# A brake that speaks CAN FD, one frame a direction, protected by AUTOSAR's profile 7, and sleeps until it is woken: a check,
# the frames of it through `can check`, and faults, each of which ends at zero torque as fast as over classic frames.
. ./common.sh
. ./bench.sh
. ./faults.sh
dbc=/bench/brake_fd.dbc
can_settings='data_bitrate = 4000000
'"$(cat brake_fd.toml)"'
[[can.startup]]
message = "ModeRequest"
signals = { Mode = 1, Key = 165 }
wait_ms = 30
[[can.startup]]
message = "ModeRequest"
signals = { Mode = 3 }
[[can.shutdown]]
message = "ModeRequest"
signals = { Mode = 0 }'
brake_speaks_as_configured

use_vcan
ip link set vcan0 down
ip link set vcan0 mtu 16 # classic frames only
expect "vcan0 is up for classic frames" bring_up vcan0
code=0
clampd-plant --interface vcan0 --config plant.toml $brake_frames >/tmp/refused 2>&1 || code=$?
expect "a bus without CAN FD is refused" [ $code = 2 ]
expect "the refusal says what to do" grep -q "vcan0 is not set up for CAN FD.*mtu 72" /tmp/refused
ip link set vcan0 down
ip link set vcan0 mtu 72
expect "vcan0 is up for CAN FD" bring_up vcan0

start_brake /tmp/trace.csv
start_station
wait_for_idle
healthy_check_and_its_frames 180:7FF
check full 20
expect_pass full
expect_on_time full
fault "plant killed" 'cause kill 9 $brake_pid' 'start_brake /tmp/trace_2.csv'
brake_is_silent() { wait_until 5 "the brake sleeps" no_frames; }
no_frames() { [ -z "$(timeout 0.2 candump -n 1 vcan0,180:7FF)" ]; }
frames() { [ -n "$(timeout 1 candump -n 1 vcan0,180:7FF)" ]; }
expect "the brake sends while the station runs" frames
kill $station_pid
wait $station_pid
brake_is_silent
echo "ok: the station put the brake to sleep when it ended"
start_station
wait_for_idle
scripted_fault corrupt-crc
scripted_fault frozen-counter
scripted_fault impossible-values
