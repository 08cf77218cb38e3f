# The Debian package on a Debian: installed, started, watched, upgraded, removed.
#
# debian
# qemu: -m 1536 -object can-bus,id=cb0 -device kvaser_pci,canbus=cb0
. ./common.sh
. ./bench.sh
. ./installed.sh

status() {
  technician clampctl status --json >/tmp/status.json 2>/tmp/status.err && json_get /tmp/status.json "/$1"
}

# check NAME REPEATS
check() {
  code=0
  technician clampctl run --serial "SYSTEMD-$1" --repeats "$2" --json "/tmp/$1.json" >"/tmp/$1.out" 2>&1 || code=$?
}

installed_and_quiet() {
  echo "--- installed"
  install_station
  expect "its user is there" [ "$(id -un clampd)" = clampd ]
  expect "its user is in the panel's group" [ "$(id -nG clampd)" = "clampd gpio" ]
  expect "nothing starts by itself" property_is clampd ActiveState inactive
  expect "and nothing is enabled" [ "$(systemctl is-enabled clampd)" = disabled ]
}

waits_for_its_interface() {
  echo "--- without a CAN interface"
  expect "enabled" quietly systemctl enable clampd
  systemctl start --no-block clampd
  wait_until 20 "it tries again" tried_again
  expect "it names the interface that is missing" in_journal "vcan0" --priority=crit
  use_vcan
  start_brake /tmp/trace.csv
  wait_until 20 "it starts once the interface is there" property_is clampd ActiveState active
}

runs_as_it_should() {
  echo "--- as its own user, in real time"
  pid=$(property clampd MainPID)
  wait_for_idle
  wait_until 5 "systemctl says so" property_is clampd StatusText "IDLE on vcan0"
  expect "it belongs to its user" [ "$(stat -c %U:%G /proc/"$pid")" = clampd:clampd ]
  expect "it has no capability" grep -q '^CapEff:[[:space:]]*0*$' /proc/"$pid"/status
  expect "it can get none" grep -q '^NoNewPrivs:[[:space:]]*1$' /proc/"$pid"/status
  for task in /proc/"$pid"/task/*; do
    echo "$(cat "$task/comm") $(chrt -p "${task##*/}" | sed 's/.*: //' | tr '\n' ' ')"
  done | sort | uniq -c >/tmp/threads
  cat /tmp/threads
  expect "its loop is SCHED_FIFO $station_priority" grep -q "1 clampd-rt SCHED_FIFO $station_priority" /tmp/threads
  expect "no other thread of it is real-time" [ "$(grep -c SCHED_FIFO /tmp/threads)" = 1 ]
  expect "the thread that takes a stop goes before ordinary ones" [ "$(awk '$19 == -10' /proc/"$pid"/task/*/stat | wc -l)" = 1 ]
  expect "its memory is locked" [ "$(awk '/^VmLck:/ { print $2 }' /proc/"$pid"/status)" -gt 0 ]
  expect "it forbids deep sleep" quietly sh -c "ls -l /proc/$pid/fd | grep cpu_dma_latency"
  expect "systemd listens for it" property_is clampd.socket SubState running
  expect "a stranger reads the status" quietly runuser -u nobody -- clampctl status
  expect "whoever stands at the machine stops it" quietly runuser -u nobody -- clampctl stop
  runuser -u nobody -- clampctl run --serial STRANGER >/tmp/stranger.out 2>&1 && fail "a stranger moved the brake"
  echo "ok: and cannot start a check: $(head -n 1 /tmp/stranger.out)"
}

checks_a_brake() {
  echo "--- a check"
  check full 20
  cat /tmp/full.out
  expect_pass full
  expect "no period skipped" [ "$(json_get /tmp/full.json /timing/skipped)" = 0 ]
  expect "no sample lost" [ "$(json_get /tmp/full.json /timing/lost_samples)" = 0 ]
  expect "its record is in the state directory" [ -s /var/lib/clampd/checks.sqlite ]
  expect "the operator finds it" quietly sh -c "runuser -u technician -- clampctl results | grep SYSTEMD-full"
  expect "the journal has it" in_journal "$(json_get /tmp/full.json /record) of SYSTEMD-full: PASS"
  in_journal "SYSTEMD-full: PASS" --priority=warning && fail "a PASS is no warning"
  expect "no error in the journal since it is ready" [ -z "$(journalctl --quiet --unit clampd --priority err --since "@$ready_s")" ]
}

# A process that stands still as a whole, in the middle of a check.
restarted_when_hung() {
  echo "--- hung in a check"
  token=$(cat /run/clampd/token)
  restarts=$(property clampd NRestarts)
  candump -D -L "vcan0,100:7FF" >/tmp/commands.log 2>/dev/null &
  candump_pid=$!
  check hung 20 &
  check_pid=$!
  wait_until 20 "the check runs" station_is RUNNING
  sleep 1
  hung_s=$(date +%s.%N)
  kill -STOP "$pid"
  sleep 10
  wait_until 20 "the watchdog restarts it" restarted
  wait "$check_pid"
  expect "it was the watchdog" in_journal "Watchdog timeout"
  wait_until 20 "it is ready again" property_is clampd ActiveState active
  expect "as another process" [ "$(property clampd MainPID)" != "$pid" ]
  wait_until 20 "it leaves INIT" left_init
  sleep 2
  kill $candump_pid
  wait $candump_pid
  expect "the drive was on before" [ "$(enabled_after 0)" -gt 1000 ]
  expect "commands are sent after" [ "$(awk -v hung="$hung_s" 'substr($1, 2) + 0 > hung + 0.01' /tmp/commands.log | wc -l)" -gt 500 ]
  expect "none of them enables the drive" [ "$(enabled_after "$hung_s")" = 0 ]
  expect "the screen's token is the same" [ "$(cat /run/clampd/token)" = "$token" ]
  if station_is FAULT; then technician clampctl clear; fi
  wait_for_idle
  check again 2
  expect_pass again
  pid=$(property clampd MainPID)
}
left_init() { station_is IDLE || station_is FAULT; }
# In the frame BrakeCommand Enable is the lowest bit of the third byte.
enabled_after() {
  awk -v after="$1" 'substr($1, 2) + 0 > after + 0.01 && index("13579BDF", substr($3, 10, 1))' /tmp/commands.log | wc -l
}

refuses_a_wrong_configuration() {
  echo "--- wrong configuration"
  cp -p /etc/clampd/station.toml /tmp/station.good
  sed -i 's/^port = 8371/port = 8372/' /etc/clampd/station.toml
  systemctl restart clampd 2>/dev/null && fail "it started on another port than its socket's"
  expect "it says where the socket listens" in_journal "clampd.socket listens on 127.0.0.1:8371" --priority=crit
  wait_until 5 "and stays down" property_is clampd ActiveState failed
  cp -p /tmp/station.good /etc/clampd/station.toml
  expect "it starts when that is mended" quietly systemctl restart clampd
  wait_for_idle
  pid=$(property clampd MainPID)
}

# The same package with a higher version and another station.toml.
upgraded() {
  echo "--- upgrade"
  dpkg-deb -R clampd*.deb /tmp/next
  sed -i 's/^Version: .*/Version: 99/' /tmp/next/DEBIAN/control
  echo '# a newer default' >>/tmp/next/etc/clampd/station.toml
  echo '# a newer default' >>/tmp/next/etc/clampd/limits.toml
  quietly dpkg-deb -Znone -b /tmp/next /tmp/clampd_99_amd64.deb
  expect "apt upgrades" apt install /tmp/clampd_99_amd64.deb
  expect "it is the new one" [ "$(dpkg-query -W -f '${Version}' clampd)" = 99 ]
  expect "the station's configuration is kept" cmp /etc/clampd/station.toml /tmp/station.good
  expect "the new default lies beside it" grep -q 'newer default' /etc/clampd/station.toml.dpkg-dist
  expect "what nobody changed is new" grep -q 'newer default' /etc/clampd/limits.toml
  wait_until 20 "it runs again" property_is clampd ActiveState active
  expect "as another process" [ "$(property clampd MainPID)" != "$pid" ]
  wait_for_idle
  expect "the records are there" quietly sh -c "runuser -u technician -- clampctl results | grep SYSTEMD-full"
}

sets_up_can() {
  echo "--- clampd-can@can0"
  wait_until 20 "the controller is there" quietly ip link show can0
  expect "enabled and started" quietly systemctl enable --now clampd-can@can0
  expect "it is up" can_is_set_up
  controller=$(basename "$(readlink /sys/class/net/can0/device)")
  echo "$controller" >/sys/bus/pci/drivers/kvaser_pci/unbind
  wait_until 20 "the unit goes with the controller" property_is clampd-can@can0 ActiveState inactive
  echo "$controller" >/sys/bus/pci/drivers/kvaser_pci/bind
  wait_until 20 "it is set up when it is back" can_is_set_up
}
can_is_set_up() {
  ip -details link show can0 >/tmp/can0 2>&1 && grep -q ',UP' /tmp/can0 && grep -q 'bitrate 1000000' /tmp/can0 &&
    grep -q 'restart-ms 100' /tmp/can0 && grep -q 'qlen 10$' /tmp/can0
}

removed() {
  echo "--- removed"
  stop_brake
  expect "apt removes" apt remove clampd
  expect "nothing of it runs" [ -z "$(find /proc -maxdepth 1 -user clampd)" ]
  expect "its socket is closed" [ -z "$(ss -Hltn 'sport = :8371')" ]
  expect "configuration and records stay" [ -s /etc/clampd/station.toml -a -s /var/lib/clampd/checks.sqlite ]
  expect "apt purges" apt purge clampd
  expect "the records stay all the same, and their owner" [ -s /var/lib/clampd/checks.sqlite -a -n "$(getent passwd clampd)" ]
  rm -r /var/lib/clampd
  find / -xdev -name '*clampd*' -not -path '/proc/*' -not -path '/sys/*' -not -path '/bench/*' -not -path '/tmp/*' \
    -not -path '/var/cache/apt/*' >/tmp/left
  [ ! -s /tmp/left ] || fail "left: $(tr '\n' ' ' </tmp/left)"
  echo "ok: nothing is left"
}

installed_and_quiet
waits_for_its_interface
ready_s=$(date +%s)
runs_as_it_should
checks_a_brake
restarted_when_hung
refuses_a_wrong_configuration
upgraded
sets_up_can
removed
