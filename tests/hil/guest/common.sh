# Shared by the scenarios; sourced by busybox sh in the guest.
[ ! -e ./environment ] || . ./environment

# This shell prefers its own commands to those in /bin, and its own ip knows no CAN.
ip() { /bin/ip "$@"; }

fail() {
  for file in /tmp/station.log /tmp/status.err /tmp/status.json; do
    [ ! -e $file ] || tail -n 5 $file
  done
  echo "FAILED: $*"
  exit 1
}

# expect WHAT COMMAND...: the command must succeed.
expect() {
  what=$1
  shift
  "$@" || fail "$what"
  echo "ok: $what"
}

# at_most WHAT VALUE LIMIT: decimal numbers.
at_most() {
  awk -v value="$2" -v limit="$3" 'BEGIN { exit !(value + 0 <= limit + 0 && value != "") }' ||
    fail "$1: $2 is not at most $3"
  echo "ok: $1: $2 <= $3"
}

# wait_until SECONDS WHAT COMMAND...: polls in guest time, every $poll_s.
poll_s=0.02
wait_until() {
  limit_s=$1
  what=$2
  shift 2
  begin_s=$(cut -d' ' -f1 /proc/uptime)
  until "$@"; do
    awk -v begin="$begin_s" -v limit="$limit_s" '{ exit !($1 - begin < limit) }' /proc/uptime ||
      fail "$what: not within $limit_s s"
    sleep $poll_s
  done
}

# cyclictest_max PRIORITY SECONDS: worst wake-up lateness in microseconds, 1 ms interval, as the station's loop.
cyclictest_max() {
  cyclictest --quiet --mlockall --priority="$1" --interval=1000 --loops=$(($2 * 1000)) >/tmp/cyclictest.log 2>&1 ||
    fail "cyclictest: $(cat /tmp/cyclictest.log)"
  sed -n 's/.*Max: *\([0-9]*\).*/\1/p' /tmp/cyclictest.log
}
