# A disk that is full or may only be read, and a clock that is set in the middle of a check.
. ./common.sh
. ./bench.sh
. ./faults.sh
use_vcan
database=/disk/checks.sqlite
mkdir /disk
mount -t tmpfs -o size=2m tmpfs /disk || fail "no disk of its own"
start_brake /tmp/trace.csv
start_station
wait_for_idle

# begin NAME REPEATS: a check in the background, until its brake is clamped.
begin() {
  id=$1
  clampctl --config /tmp/station.toml run --serial HIL-1 --repeats "$2" --json "/tmp/$id.json" >"/tmp/$id.out" 2>&1 &
  check_pid=$!
  wait_until 20 "the brake is clamped" clamped
}
end_of_check() {
  code=0
  wait $check_pid || code=$?
}
# newest_is NAME: the record of that check is the first of the list, with its verdict.
newest_is() {
  clampctl --config /tmp/station.toml results --json >/tmp/results.json 2>/tmp/results.err || fail "results: $(cat /tmp/results.err)"
  record=$(json_get "/tmp/$1.json" /record)
  [ -n "$record" ] && [ "$(json_get /tmp/results.json /checks/0/record)" = "$record" ] ||
    fail "the newest check is $(json_get /tmp/results.json /checks/0/record), not $1, $record"
  expect "$1 is the newest on record, and PASS" [ "$(json_get /tmp/results.json /checks/0/verdict)" = PASS ]
}
# check_while_the_clock_moves NAME SECONDS
check_while_the_clock_moves() {
  begin "$1" 4
  date -s "@$(($(date +%s) + $2))" >/dev/null
  end_of_check
  expect_pass "$1"
  expect "the status says that it was set $1" sh -c "echo '$(status clock)' | grep -q 'the clock was set $1'"
  expect "no period skipped" [ "$(json_get "/tmp/$1.json" /timing/skipped)" = 0 ]
  at_most "its duration in s" "$(json_get "/tmp/$1.json" /duration_s)" 10
  newest_is "$1"
}
saved() { [ -z "$(status storage)" ]; }

echo "--- the disk fills up in a check"
begin full 12
dd if=/dev/zero of=/disk/ballast bs=4096 2>/dev/null
end_of_check
[ $code = 3 ] || fail "exit code $code instead of 3: $(cat /tmp/full.out)"
reason=$(json_get /tmp/full.json /reason)
case $reason in
  "Judged PASS, but the result of HIL-1 could not be saved: "*"the disk is full"*) echo "ok: ERROR: $reason" ;;
  *) fail "the reason is '$reason'" ;;
esac
case $(status storage) in *"the disk is full"*) echo "ok: the status says so" ;; *) fail "the status says '$(status storage)'" ;; esac
check refused 1
[ $code = 3 ] && grep -q "no brake is checked" /tmp/refused.out || fail "refused: $code $(cat /tmp/refused.out)"
echo "ok: no other brake is checked"
rm /disk/ballast
wait_until 10 "the result is saved once there is room" saved
newest_is full
check after 1
expect_pass after
newest_is after

echo "--- the clock is set back by an hour in a check"
check_while_the_clock_moves back -3600
check earlier 1
expect_pass earlier
newest_is earlier

echo "--- the clock is set forward by two hours in a check"
check_while_the_clock_moves forward 7200
kill -0 $station_pid || fail "the station is gone"

echo "--- a disk that may only be read"
kill $station_pid
wait $station_pid
mount -o remount,ro /disk || fail "remount"
code=0
clampd --config /tmp/station.toml >/tmp/read_only.log 2>&1 || code=$?
[ $code = 2 ] && grep -q "/disk/checks.sqlite" /tmp/read_only.log || fail "exit code $code: $(cat /tmp/read_only.log)"
echo "ok: the station does not start: $(tail -n 1 /tmp/read_only.log)"
mount -o remount,rw /disk
start_station
wait_for_idle
newest_is forward
check again 1
expect_pass again
newest_is again
