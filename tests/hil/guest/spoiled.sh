# Readings that lie, in frames whose checksums and counters are right: sourced after faults.sh.
#
# What counts is what really was: the columns force_N, velocity_rad_s and torque_Nm of the brake's trace are the true ones
# and never the spoiled readings.

readonly lying_reading_ms=60 # until readings have contradicted each other for long enough
readonly spoiled_repeats=3
readonly spoiled_start_s=1.5 # of the brake's own time, when the check starts: by then the station is IDLE again
readonly far_sd=5            # beyond the guard band, and beyond what chance does

# A line for each check: reading, how it ended, whether the reason names the reading, whether the brake was unsafe, worst
# true speed and force, milliseconds from the instant to the end of the drive.
readonly results=/tmp/spoiled.txt

# spoiled_reading READING KIND WORD: a reading lies as soon as the brake is clamped. WORD must stand in the reason.
spoiled_reading() {
  stop_brake
  brake_tables=$(printf '[[spoil]]\nreading = "%s"\nkind = "%s"\n%s' "$1" "$2" "$scripted_times")
  start_brake /tmp/trace.csv
  brake_tables=
  expect_scripted "$1 $2" $lying_reading_ms "$3"
}

# supervisor_limit KEY: of the station, which has the defaults that its documented configuration shows.
supervisor_limit() { awk -v key="$1" '$1 == key { print $3 }' configs/station.toml; }

# Learns how long a check takes ($check_s), and what passes before it from the command on ($command_s).
measure_check() {
  begin_s=$(cut -d' ' -f1 /proc/uptime)
  check measured $spoiled_repeats
  expect_pass measured
  awk -F, -v begin="$begin_s" '
    NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; columns = NF; next }
    NF == columns && $at["time_s"] > begin && $at["enabled"] == 1 {
      if (first == "") first = $at["time_s"]
      last = $at["time_s"]
    }
    END { if (first != "") print first - begin, last - first }' "$trace" >/tmp/measured
  read -r command_s check_s </tmp/measured || fail "the drive was never enabled"
  echo "ok: a healthy check takes $check_s s, and begins $command_s s after the command"
}

# draw NUMBER: "READING KIND AMOUNT INSTANT_S" of a check, as gross_spoil() in tests/scenario/reading_campaign.cpp draws
# them, then lines for $brake_values: two of three brakes lie anywhere in the paper's Table II, as table_ii_brake() there. The
# instant counts from the check's start. 35 checks in a row meet each reading in each kind.
draw() {
  awk -v number="$1" -v duration="$check_s" '
    function uniform(lower, upper) { return lower + (upper - lower) * rand() }
    function parameter(name, nominal, lower, upper) { printf "%s %.6g\n", name, nominal * uniform(lower, upper) }
    BEGIN {
      split("force velocity position torque encoder", readings)
      split("frozen scaled negated offset late noisy silent", kinds)
      split("16e3 150 30 2 30", offsets)
      split("12e3 100 4 1.5 4", noises)
      srand(1) # One sequence for all checks: what is drawn from seeds in a row is nearly equally spaced.
      for (i = 0; i < 16 * number; i++) rand()
      reading = number % 5 + 1
      kind = kinds[number % 7 + 1]
      instant = uniform(0, duration)
      amount = 0
      if (kind == "scaled") amount = rand() < 0.5 ? uniform(0, 0.7) : uniform(1.4, 3)
      if (kind == "offset") amount = (rand() < 0.5 ? 1 : -1) * uniform(0.25, 1) * offsets[reading]
      if (kind == "late") amount = int(uniform(15, 100))
      if (kind == "noisy") amount = uniform(0.25, 1) * noises[reading]
      printf "%s %s %.4f %.4f\n", readings[reading], kind, amount, instant
      print "seed", 1000 + number
      if (number % 3 == 0) exit
      parameter("k1", -3.54e-1, 0.80, 1.0)
      parameter("k2", 3.52e1, 0.89, 1.0)
      parameter("TC", 7.67e-2, 1.0, 1.67)
      parameter("Ts0", 4.68e-2, 0.92, 1.0)
      parameter("Tv", 4.46e-4, 1.0, 2.45)
      parameter("mus", 3.55e-5, 0.875, 1.05)
      parameter("ws", 2.89e1, 0.38, 1.0)
    }'
}

# spoiled_check NUMBER: one check on a brake of its own, whose reading lies from the instant on. Appends to $results.
spoiled_check() {
  draw "$1" >/tmp/drawn
  read -r reading kind amount instant_s </tmp/drawn
  brake_values=$(tail -n +2 /tmp/drawn)
  at_s=$(awk -v instant="$instant_s" -v start=$spoiled_start_s 'BEGIN { printf "%.4f", start + instant }')
  brake_tables=$(printf '[[spoil]]\nreading = "%s"\nkind = "%s"\namount = %s\nat_s = %s' \
    "$reading" "$kind" "$amount" "$at_s")
  start_ready_brake
  brake_tables=
  wait_until 10 "the time to start the check" later_than "$brake_begin_s" $spoiled_start_s "-$command_s" -0.02
  begin_fault "$1 $reading $kind"
  code=0
  wait $check_pid || code=$?
  sleep 0.1 # whatever still moves the brake shows in its trace
  clocks=$(cause kill 0 $$)
  stop_recording
  judge_spoiled_check
  stop_brake
}

# A brake of which the station is ready in time for the check: begun again where that took too long, since readings that lie
# while the brake stands still may keep the station from getting ready at all.
start_ready_brake() {
  tries=0
  start_brake /tmp/trace.csv
  until ready_in_time; do
    tries=$((tries + 1))
    [ $tries -lt 5 ] || fail "the station is not ready $spoiled_start_s s after the brake's start, five times in a row"
    stop_brake
    start_brake /tmp/trace.csv
  done
}

# Waits for what the check needs until it would begin too late.
ready_in_time() {
  brake_begin_s=$(awk -F, 'NR == 2 { print $1; exit }' "$trace")
  until clearable; do
    later_than "$brake_begin_s" $spoiled_start_s "-$command_s" && return 1
    sleep $poll_s
  done
  clear_fault
  ! later_than "$brake_begin_s" $spoiled_start_s "-$command_s"
}

# Judges by the record, by what the brake's trace says of the truth, and by the commands on the bus.
judge_spoiled_check() {
  true_course "$trace" "$at_s" >/tmp/course
  read -r speed force check_begin_s spoiled_s off_s undriven_s </tmp/course
  if [ -z "$undriven_s" ]; then
    judge_idle_station
    return
  fi
  verdict=$(json_get "/tmp/$id.json" /verdict)
  reason=$(json_get "/tmp/$id.json" /reason)
  fault=$(json_get "/tmp/$id.json" /fault)
  after_ms=$(milliseconds "$spoiled_s" "$off_s")
  torque_ms=0
  named=0
  wrong=
  case $fault:$verdict:$code in
    none:ERROR:3) ended=refused ;;
    none:PASS:0 | none:FAIL:1)
      wrong=$(wrong_parameters "$id")
      ended=${wrong:+wrong}
      ended=${ended:-harmless}
      ;;
    none:*) fail "$name: verdict $verdict, exit code $code: $reason" ;;
    *:ERROR:3)
      ended=fault
      above 0 "$after_ms" && fail "$name: a fault before anything was spoiled: $reason"
      if names "$reading"; then named=1; fi
      expect_answered_fault
      torque_ms=$(milliseconds "$(drive_off_command /tmp/commands.log "$clocks")" "$undriven_s")
      above 0 "$torque_ms" && torque_ms=0.0 # no torque was asked for when the fault came
      ;;
    *) fail "$name: verdict $verdict, exit code $code after the fault $fault: $reason" ;;
  esac
  unsafe=0
  if above "$speed" "$speed_most" || above "$force" "$force_most" || above "$torque_ms" $zero_torque_ms; then unsafe=1; fi
  echo "$reading $ended $named $unsafe $speed $force $after_ms" >>$results
  echo "$ended: $name $amount at $(milliseconds "$check_begin_s" "$spoiled_s") ms: $verdict, $fault;" \
    "to $speed rad/s, $force N; off $after_ms ms after the instant, torque until $torque_ms ms after the fault"
  [ $unsafe = 0 ] || echo "UNSAFE: $name: $reason"
  [ -z "$wrong" ] || echo "WRONG: $name: $wrong: $reason"
  [ $ended:$named != fault:0 ] || echo "UNNAMED: $name: $reason"
}

# A reading that begins to lie just before the drive is enabled may be noticed by then, so that nothing moves.
judge_idle_station() {
  [ "$(status state)" = FAULT ] || fail "$name: the drive was never enabled, or the brake ended before the instant"
  case $code in 0 | 1) fail "$name: exit code $code of a check that never began" ;; esac
  echo "$reading early 0 0 $speed $force 0" >>$results
  echo "early: $name $amount: $(status fault) before anything moved"
}

above() { awk -v value="$1" -v limit="$2" 'BEGIN { exit !(value + 0 > limit + 0) }'; }

# names READING: whether the reason does, as names() of the embedded campaign. The encoder is behind two readings.
names() {
  case $1:$reason in
    encoder:"Position and velocity agree"* | encoder:"The velocity reading is"* | encoder:"The position reading is"*) ;;
    *:"The $1 reading is"*) ;;
    *) return 1 ;;
  esac
}

# The flight recorder ends with the sample that raised the fault, and its answer must ask for no torque: so the station's
# fault and its first command with the drive off are one tick.
expect_answered_fault() {
  clampctl --config /tmp/station.toml results last --flight /tmp/flight.csv >/tmp/flight.out 2>&1 ||
    fail "$name: no flight recorder: $(cat /tmp/flight.out)"
  answer=$(awk -F, '
    NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; next }
    { answer = $at["fault"] " " ($at["torque_command_Nm"] + 0) }
    END { print answer }' /tmp/flight.csv)
  [ "$answer" = "$fault 0" ] || fail "$name: the flight recorder ends with '$answer', not with $fault and no torque"
}

# true_course TRACE AT_S: worst speed and force, and when in monotonic time the drive was first enabled, the reading was
# spoiled, the drive was last enabled and the motor last driven.
true_course() {
  awk -F, -v spoil="$2" '
    NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; columns = NF; next }
    NF != columns { next }
    {
      time = $at["time_s"]
      speed = $at["velocity_rad_s"] < 0 ? -$at["velocity_rad_s"] : $at["velocity_rad_s"]
      if (speed > worst_speed) worst_speed = speed
      if ($at["force_N"] > worst_force) worst_force = $at["force_N"]
      if (spoiled == "" && $at["sample"] >= spoil * 1000) spoiled = time
      if (enabled) off = time
      if (driven) undriven = time
      enabled = $at["enabled"] == 1
      driven = $at["torque_Nm"] != 0
      if (enabled && begin == "") begin = time
    }
    END {
      if (undriven == "") undriven = off
      printf "%.1f %.0f %s %s %s %s\n", worst_speed, worst_force, begin, spoiled, off, undriven
    }' "$1"
}

# wrong_parameters CHECK: those which are far from the truth, each with its value and sd.
wrong_parameters() {
  index=0
  while [ $index -lt 7 ]; do
    parameter=$(json_get "/tmp/$1.json" /parameters/$index/name)
    value=$(json_get "/tmp/$1.json" /parameters/$index/value)
    sd=$(json_get "/tmp/$1.json" /parameters/$index/sd)
    awk -v value="$value" -v sd="$sd" -v truth="$(truth "$parameter")" -v far=$far_sd \
      'BEGIN { d = value - truth; exit !((d < 0 ? -d : d) <= far * sd) }' ||
      echo "$parameter = $value instead of $(truth "$parameter"), sd $sd"
    index=$((index + 1))
  done
}

# The table of all checks, one line for each reading.
print_spoiled() {
  awk '
    function row(name, n, i, j, t, median) {
      for (i = 2; i <= latencies[name]; i++) # the few there are, by insertion
        for (j = i; j > 1 && latency[name, j] < latency[name, j - 1]; j--) {
          t = latency[name, j]; latency[name, j] = latency[name, j - 1]; latency[name, j - 1] = t
        }
      n = latencies[name]
      median = n ? sprintf("%.0f", latency[name, int((n + 1) / 2)]) : "-"
      printf "%-9s %6d %6d %6d %8d %7d %5d %5d %6d %9.0f %7.0f %9s %8s\n", name, checks[name], ends[name, "fault"], named[name],
        ends[name, "harmless"], ends[name, "refused"], ends[name, "early"], ends[name, "wrong"], unsafe[name], speed[name], force[name], median,
        n ? sprintf("%.0f", latency[name, n]) : "-"
    }
    function add(name) {
      checks[name]++
      ends[name, $2]++
      named[name] += $3
      unsafe[name] += $4
      if ($5 > speed[name]) speed[name] = $5
      if ($6 > force[name]) force[name] = $6
      if ($2 == "fault") latency[name, ++latencies[name]] = $7
    }
    { add($1); add("all") }
    END {
      printf "%-9s %6s %6s %6s %8s %7s %5s %5s %6s %9s %7s %9s %8s\n", "reading", "checks", "faults", "named", "harmless",
        "refused", "early", "wrong", "unsafe", "max rad/s", "max N", "median ms", "worst ms"
      count = split("force velocity position torque encoder all", names)
      for (k = 1; k <= count; k++) if (checks[names[k]]) row(names[k])
    }' $results
}

# counted FIELD VALUE: checks whose result has that value there.
counted() { awk -v field="$1" -v value="$2" '$field == value { n++ } END { print n + 0 }' $results; }

# spoiled_campaign CHECKS FIRST: no reading harms in any of the checks from number FIRST on, and nearly every fault names the
# reading that lied.
spoiled_campaign() {
  speed_most=$(awk -v limit="$(supervisor_limit over_speed_rad_s)" 'BEGIN { print 1.2 * limit }')
  force_most=$(awk -v limit="$(supervisor_limit over_force_N)" 'BEGIN { print 1.1 * limit }')
  above "$speed_most" 0 && above "$force_most" 0 || fail "no limits in configs/station.toml"
  fault_repeats=$spoiled_repeats
  check_timeout_s=900 # a fit that has to begin again takes minutes on an emulated processor
  : >$results
  stop_brake
  number=$2
  while [ $number -lt $(($2 + $1)) ]; do
    spoiled_check $number
    number=$((number + 1))
  done
  brake_values=
  print_spoiled
  faults=$(counted 2 fault)
  expect "all $1 checks were judged" [ "$(wc -l <$results)" = "$1" ]
  expect "no check was unsafe: beyond $speed_most rad/s or $force_most N, or driven after the fault" [ "$(counted 4 1)" = 0 ]
  expect "no verdict rests on a wrong parameter" [ "$(counted 2 wrong)" = 0 ]
  at_most "checks without a fault, or there was nothing to see" $(($1 - faults)) "$(awk -v n="$1" 'BEGIN { print 0.2 * n }')"
  at_most "faults that do not name the reading" $((faults - $(counted 3 1))) \
    "$(awk -v n="$faults" 'BEGIN { print (0.05 * n > 1) ? 0.05 * n : 1 }')"
}
