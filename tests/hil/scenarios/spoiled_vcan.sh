# One reading spoiled in each check, at a random instant, in frames that are right: whatever lies, the true brake stays within
# its limits, its torque ends with the station's fault, and no verdict rests on the lie. The same campaign with an embedded
# brake, in thousands, is tests/scenario/reading_campaign.cpp.
#
# environment: CLAMPD_SPOILED_READINGS
. ./common.sh
. ./bench.sh
. ./faults.sh
use_vcan

checks=${CLAMPD_SPOILED_READINGS:-5}
readonly speed_most_rad_s=420 # 1.2 times the station's limit
readonly force_most_N=36300   # 1.1 times
readonly earliest_s=1.0       # after the brake began: by then the station is IDLE again
# What no fault ends is judged by its estimate; the search for its cause takes minutes on an emulated processor.
station_tables='[check]
tare_s = 0.1
diagnose = false'

# spoil NUMBER: reading, kind, amount and instant of a check, as the embedded campaign draws them.
spoil() {
  awk -v n="$1" -v earliest="$earliest_s" -v duration="$duration_s" '
    function uniform(lower, upper) { return lower + (upper - lower) * rand() }
    function either_sign(size) { return rand() < 0.5 ? size : -size }
    BEGIN {
      split("force velocity position torque encoder", readings, " ")
      split("frozen negated silent noisy offset late scaled", kinds, " ")
      split("16e3 150 30 2 30", offsets, " ")
      split("12e3 100 4 1.5 4", noises, " ")
      srand(n + 77); rand()
      r = (n - 1) % 5 + 1
      kind = kinds[(n - 1 + int((n - 1) / 5)) % 7 + 1] # in 35 checks each kind of each reading
      amount = 0
      if (kind == "scaled") amount = rand() < 0.5 ? uniform(0, 0.7) : uniform(1.4, 3)
      if (kind == "offset") amount = either_sign(uniform(0.25, 1)) * offsets[r]
      if (kind == "late") amount = int(uniform(15, 100))
      if (kind == "noisy") amount = uniform(0.25, 1) * noises[r]
      printf "%s %s %.6g %.4f\n", readings[r], kind, amount, earliest + uniform(0, duration)
    }'
}

# names CAUSE READING: as names() of the embedded campaign.
names() {
  case $2:$1 in
    encoder:torque-against-motion | encoder:velocity-reading | encoder:position-reading) return 0 ;;
    *) [ "$1" = "$2-reading" ] ;;
  esac
}

# largest COLUMN: largest absolute value in the brake's trace.
largest() {
  awk -F, -v column="$1" '
    NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; columns = NF; next }
    NF == columns { value = $at[column]; if (value < 0) value = -value; if (value > most) most = value }
    END { printf "%.1f\n", most }' "$trace"
}

# expect_no_wrong_parameter CHECK: every estimate within its guard band and what chance does, as in the embedded campaign.
expect_no_wrong_parameter() {
  index=0
  while [ $index -lt 7 ]; do
    parameter=$(json_get "/tmp/$1.json" /parameters/$index/name)
    value=$(json_get "/tmp/$1.json" /parameters/$index/value)
    sd=$(json_get "/tmp/$1.json" /parameters/$index/sd)
    awk -v value="$value" -v sd="$sd" -v truth="$(truth "$parameter")" \
      'BEGIN { d = value - truth; exit !((d < 0 ? -d : d) <= 5 * sd) }' ||
      fail "$1: $parameter = $value, truth $(truth "$parameter"), sd $sd"
    index=$((index + 1))
  done
}

start_brake /tmp/trace.csv
start_station
wait_for_idle
check healthy 2
expect_pass healthy
duration_s=$(json_get /tmp/healthy.json /duration_s)
echo "ok: a healthy check takes $duration_s s"

number=0
faults=0
named=0
while [ $number -lt "$checks" ]; do
  number=$((number + 1))
  spoil $number >/tmp/spoil
  read -r reading kind amount at_s </tmp/spoil
  stop_brake
  brake_tables=$(printf '[[spoil]]\nreading = "%s"\nkind = "%s"\namount = %s\nat_s = %s' "$reading" "$kind" "$amount" "$at_s")
  start_brake /tmp/trace.csv
  wait_until 10 "the fault can be cleared" clearable
  clear_fault
  brake_begin_s=$(awk -F, 'NR == 2 { print $1; exit }' "$trace")
  wait_until 10 "the time to start the check" later_than "$brake_begin_s" "$earliest_s"
  id=spoiled-$number
  check $id 2
  verdict=$(json_get "/tmp/$id.json" /verdict)
  cause=$(json_get "/tmp/$id.json" /fault)
  sleep 0.05
  at_most "$id ($reading $kind $amount at $at_s s): true speed" "$(largest velocity_rad_s)" $speed_most_rad_s
  at_most "$id: true force" "$(largest force_N)" $force_most_N
  torque_Nm=$(tail -n 20 "$trace" | awk -F, -v columns="$(head -n 1 "$trace")" '
    BEGIN { n = split(columns, name, ","); for (i = 1; i <= n; i++) at[name[i]] = i }
    NF == n && $at["torque_Nm"] != 0 { torque = $at["torque_Nm"] }
    END { print torque + 0 }')
  [ "$torque_Nm" = 0 ] || fail "$id: the brake is still driven, with $torque_Nm N m"
  if [ -n "$cause" ] && [ "$cause" != none ]; then
    [ "$verdict" = ERROR ] && [ $code = 3 ] || fail "$id: verdict $verdict, exit code $code, after the fault $cause"
    faults=$((faults + 1))
    if names "$cause" "$reading"; then named=$((named + 1)); fi
  elif [ "$verdict" != ERROR ]; then
    expect_no_wrong_parameter $id
  fi
  echo "ok: $id: $verdict, ${cause:-none}"
done
echo "$checks checks with a spoiled reading: $faults ended in a fault, $named of them with the reading named"
expect "most spoiled readings are found" [ $faults -ge $((checks * 8 / 10)) ]
expect "at least 95 % are named, or all but one" [ $((100 * (named + 1))) -ge $((95 * faults)) ]
stop_brake
brake_tables=
start_brake /tmp/trace.csv
wait_until 10 "the fault can be cleared" clearable
clear_fault
check last 2
expect_pass last
