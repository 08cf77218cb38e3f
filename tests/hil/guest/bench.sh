# A station and a brake in one guest: sourced after common.sh. The caller sets up a bus first, which sets
# station_interface and brake_interface.
#
# The station runs at its shipped priority. The brake stands for another machine, so it must not take the processor from
# the station: it runs below it, and above everything ordinary.

station_priority=80
brake_priority=60

use_vcan() {
  expect "vcan0 exists" ip link add dev vcan0 type vcan
  expect "vcan0 is up" bring_up vcan0
  station_interface=vcan0
  brake_interface=vcan0
}

# Two controllers of the kernel's kvaser_pci driver on one emulated bus.
use_kvaser() {
  for interface in can0 can1; do
    expect "$interface is up at 1 Mbit/s" bring_up $interface
  done
  station_interface=can0
  brake_interface=can1
}

bring_up() {
  case $1 in
    can*) ip link set "$1" type can bitrate 1000000 && ip link set "$1" up ;;
    *) ip link set "$1" up ;;
  esac
}

# start_brake TRACE; brake_frames: options for other frames than the shipped ones; brake_tables: further tables of its
# configuration; brake_values: lines "NAME VALUE" for what has another value than in plant.toml.
start_brake() {
  trace=$1
  echo "${brake_values:-}" | awk '
    NR == FNR { value[$1] = $2; next }
    $2 == "=" && $1 in value { $3 = value[$1] }
    { print }' - plant.toml >/tmp/plant.toml
  printf '\n%s\n' "${brake_tables:-}" >>/tmp/plant.toml
  rm -f "$trace"
  clampd-plant --interface $brake_interface --config /tmp/plant.toml ${brake_frames:---dbc configs/brake.dbc} --realtime $brake_priority \
    --trace "$trace" >>/tmp/plant.log 2>&1 &
  brake_pid=$!
  wait_until 5 "the brake runs" trace_has_rows
}

trace_has_rows() { [ -s "$trace" ] && [ "$(wc -l <"$trace")" -gt 2 ]; }

stop_brake() {
  kill "$brake_pid"
  wait "$brake_pid" || fail "the brake ended with exit code $?: $(tail -n 3 /tmp/plant.log)"
}

start_station() {
  cat >/tmp/station.toml <<TOML
[station]
name = "virtual-bench"
[can]
interface = "$station_interface"
dbc = "${dbc:-/bench/configs/brake.dbc}"
${can_settings:-}
[realtime]
priority = $station_priority
[limits]
file = "/bench/configs/limits.toml"
[archive]
database = "${database:-/tmp/checks.sqlite}"
[control]
token_file = "/tmp/token"
${station_tables:-}
TOML
  clampd --config /tmp/station.toml >>/tmp/station.log 2>&1 &
  station_pid=$!
}

stop_station() {
  kill $station_pid
  wait $station_pid
}

wait_for_idle() { wait_until 10 "the station is IDLE" station_is IDLE; }

station_is() { [ "$(status state)" = "$1" ]; }

# status FIELD: of the station, empty if it does not answer.
status() {
  clampctl --config /tmp/station.toml status --json >/tmp/status.json 2>/tmp/status.err &&
    json_get /tmp/status.json "/$1"
}

# check NAME REPEATS: runs one in the foreground; leaves /tmp/NAME.json and $code.
check() {
  code=0
  clampctl --config /tmp/station.toml run --serial HIL-1 --repeats "$2" --json "/tmp/$1.json" >"/tmp/$1.out" 2>&1 ||
    code=$?
}

expect_pass() {
  [ "$code" = 0 ] && [ "$(json_get "/tmp/$1.json" /verdict)" = PASS ] && return
  cat "/tmp/$1.out" /tmp/station.log
  fail "$1: exit code $code, $(json_get "/tmp/$1.json" /verdict): $(json_get "/tmp/$1.json" /reason)"
}

# The brake speaks what the station's $can_settings describe, of the frames in $dbc.
brake_speaks_as_configured() {
  printf '[can]\ndbc = "%s"\n%s\n' "${dbc:-/bench/configs/brake.dbc}" "$can_settings" >/tmp/frames.toml
  brake_frames="--station /tmp/frames.toml"
}

# expect_on_time CHECK
expect_on_time() {
  echo "timing: $(json_get "/tmp/$1.json" /timing)"
  expect "no period skipped" [ "$(json_get "/tmp/$1.json" /timing/skipped)" = 0 ]
  expect "no sample lost" [ "$(json_get "/tmp/$1.json" /timing/lost_samples)" = 0 ]
}

# truth PARAMETER: of the brake that was started last.
truth() { awk -v name="$1" '$1 == name { print $3 }' /tmp/plant.toml; }

# expect_close_to_truth CHECK: every estimate within 4.5 of its reported standard deviations. The brake's noise differs from run to
# run of a guest. Of 7 estimates that are as uncertain as they say, one lies outside of 3 in every fiftieth check, and outside of
# 4.5 in every twenty-thousandth. How often the intervals hold the truth is counted elsewhere, by the campaigns.
expect_close_to_truth() {
  index=0
  while [ $index -lt 7 ]; do
    name=$(json_get "/tmp/$1.json" /parameters/$index/name)
    value=$(json_get "/tmp/$1.json" /parameters/$index/value)
    sd=$(json_get "/tmp/$1.json" /parameters/$index/sd)
    distance=$(awk -v value="$value" -v sd="$sd" -v truth="$(truth "$name")" \
      'BEGIN { d = (value - truth) / sd; print (sd > 0 ? (d < 0 ? -d : d) : "") }')
    at_most "$name = $value, truth $(truth "$name"), distance in sd ($sd)" "$distance" 4.5
    index=$((index + 1))
  done
}

# The whole check of 20 repeats: no period skipped, no sample lost, every estimate near the truth.
full_check() {
  start_brake /tmp/trace.csv
  start_station
  wait_for_idle
  # The reference: cyclictest during a check like the measured one, so that it meets all that the station's thread meets:
  # the bus, the daemon's other threads, clampctl. One priority above, since at the same one both would wait for each
  # other; and for twice as long, since a maximum is made of rare events.
  check reference 40 &
  check_pid=$!
  reference_us=$(cyclictest_max $((station_priority + 1)) 24)
  echo "cyclictest: $(tail -n 1 /tmp/cyclictest.log)"
  wait $check_pid
  expect "the check beside cyclictest passes" [ "$(json_get /tmp/reference.json /verdict)" = PASS ]
  begin_s=$(cut -d' ' -f1 /proc/uptime)
  check full 20
  echo "the command took $(awk -v begin="$begin_s" '{ print $1 - begin }' /proc/uptime) s of virtual time"
  cat /tmp/full.out
  expect_pass full
  echo "ok: verdict PASS, exit code 0"
  expect_on_time full
  at_most "wake-up lateness in us, against 1.5 times cyclictest's $reference_us" \
    "$(json_get /tmp/full.json /timing/lateness_us/max)" "$(awk "BEGIN { print 1.5 * $reference_us }")"
  at_most "bench time in s" "$(json_get /tmp/full.json /duration_s)" 30
  expect_close_to_truth full
  echo "tracking: $(json_get /tmp/full.json /tracking_rms_N) N rms"
}
