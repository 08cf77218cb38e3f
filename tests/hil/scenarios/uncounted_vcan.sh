# A brake that neither sends a clock nor counts its samples: the station finds its sampling instants from when the frames
# arrive, and frames that come again and again by what the readings then contradict. A check, its frames through `can check`,
# and faults.
. ./common.sh
. ./bench.sh
. ./faults.sh
can_settings='[can.mapping]
sample_clock = ""
counter = ""'
printf '[can]\ndbc = "/bench/configs/brake.dbc"\n%s\n' "$can_settings" >/tmp/frames.toml
brake_frames="--station /tmp/frames.toml"

use_vcan
start_brake /tmp/trace.csv
start_station
wait_for_idle
candump -L vcan0,180:7FC >/tmp/frames.log &
log_pid=$!
measure_approach
kill $log_pid
clampctl --config /tmp/station.toml can check /tmp/frames.log >/tmp/can_check 2>&1 || fail "can check: $(cat /tmp/can_check)"
expect "can check understands the brake" grep -q "understands this brake" /tmp/can_check
grep "times are told by the arrivals" /tmp/can_check || fail "can check says nothing of the arrivals"
check full 8
expect_pass full
echo "timing: $(json_get /tmp/full.json /timing)"
expect "no period skipped" [ "$(json_get /tmp/full.json /timing/skipped)" = 0 ]
expect "no sample lost" [ "$(json_get /tmp/full.json /timing/lost_samples)" = 0 ]
fault "plant killed" 'cause kill 9 $brake_pid' 'start_brake /tmp/trace_2.csv'
brake_resumes=1
fault "plant stopped" 'cause kill 19 $brake_pid' 'cause kill 18 $brake_pid'
brake_resumes=0
scripted_fault corrupt-crc
# Nothing in the frames tells that they are old: the readings do, as soon as they contradict what the drive was told.
stop_brake
at_s=6.0
start_brake /tmp/trace.csv frozen-counter $at_s 0.3
expect_scripted frozen-counter 15
scripted_fault impossible-values
