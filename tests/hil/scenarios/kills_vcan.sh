# The station is killed at 20 instants of a check, on a brake that lives on: its torque ends with its own watchdog each
# time, and the next station checks it.
. ./common.sh
. ./bench.sh
. ./faults.sh
use_vcan
station_tables='[check]
tare_s = 0.05'
start_brake /tmp/trace.csv

# last_torque CAUSE_S: milliseconds from the cause to the last sample of the trace that drove the motor, and whether one
# did in the 5 ms before.
last_torque() {
  { head -n 1 "$trace"; tail -n 1000 "$trace"; } | awk -F, -v cause="$1" '
    NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; columns = NF; next }
    NF == columns && $at["torque_Nm"] != 0 {
      if ($at["time_s"] > cause) last = $at["time_s"]
      else if ($at["time_s"] > cause - 0.005) before = 1
    }
    END { printf "%.3f %d\n", last ? (last - cause) * 1000 : 0, before }'
}

driven=0
kills=0
while [ $kills -lt 20 ]; do
  kills=$((kills + 1))
  start_station
  wait_for_idle
  clampctl --config /tmp/station.toml run --serial "KILL-$kills" --repeats 2 >/tmp/killed.out 2>&1 &
  check_pid=$!
  sleep "$(awk -v seed=$kills 'BEGIN { srand(seed); print 0.05 + 1.9 * rand() }')"
  clocks=$(cause kill 9 $station_pid)
  sleep 0.1
  last_torque "${clocks% *}" >/tmp/last_torque
  wait $station_pid
  wait $check_pid
  read -r after_ms before </tmp/last_torque
  driven=$((driven + before))
  at_most "kill $kills: end of the brake's torque, ms after it" "$after_ms" $silent_station_ms
done
echo "$driven of $kills kills hit a driven brake"
expect "many kills hit a driven brake" [ $driven -ge 8 ]
start_station
wait_for_idle
check last 2
expect_pass last
