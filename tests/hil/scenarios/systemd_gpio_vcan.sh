# The operator's panel of an installed station: the hardened service reaches its lines by its group alone; emergency stop
# in every state, lines that are pulled, and a relay that drops when the service hangs or dies.
#
# debian
# module: bench_gpio
# qemu: -m 1536
. ./common.sh
. ./bench.sh
. ./installed.sh
. ./faults.sh
. ./panel.sh

start_station() {
  systemctl start --no-block clampd
  wait_until 20 "the service is active" property_is clampd ActiveState active
  station_pid=$(property clampd MainPID)
}
stop_station() { expect "the service stops" systemctl stop clampd; }

waits_for_its_panel() {
  echo "--- without a panel"
  install_station
  # Where the scenes expect them.
  ln -s /etc/clampd/station.toml /tmp/station.toml
  printf '%s' "$panel_table" >>/etc/clampd/station.toml
  journalctl --follow --lines 0 --quiet --output cat --unit clampd >/tmp/station.log &
  # Programs of a real Debian are slow here: RELEASING and INIT would be over before they are met.
  sed -i 's/^clearance_rad = 6$/clearance_rad = 30/; s/^start_up_ms = 2000/start_up_ms = 20000/' /etc/clampd/station.toml
  expect "RELEASING and INIT last longer" [ "$(grep -c '^clearance_rad = 30$\|^start_up_ms = 20000' /etc/clampd/station.toml)" = 2 ]
  use_vcan
  start_brake /tmp/trace.csv
  systemctl start --no-block clampd
  wait_until 20 "it tries again" tried_again
  expect "it names the chip that is missing" in_journal "bench-gpio" --priority=crit
  expect "the kernel has the chip" insmod ./bench_gpio.ko
  use_panel
  start_station
  wait_for_idle
  echo "ok: it starts once the chip is there"
  expect "the chip belongs to the panel's group" [ "$(stat -c %U:%G:%a /dev/gpiochip0)" = root:gpio:660 ]
  expect "the service has no capability" grep -q '^CapEff:[[:space:]]*0*$' /proc/"$station_pid"/status
  find_guard || fail "the relay has no guard"
  expect "the guard is above the loop" sh -c "chrt -p $guard_pid | grep -q 'priority: $((station_priority + 1))'"
  expect "and belongs to the same user" [ "$(stat -c %U /proc/"$guard_pid")" = clampd ]
}

# After WHAT the service manager starts the station again, with the drive off and the relay open.
expect_restarted() {
  wait_until 30 "$name: the service is started again" restarted
  wait_until 20 "$name: it is active" property_is clampd ActiveState active
  [ "$(property clampd MainPID)" != "$station_pid" ] || fail "$name: it is still the same process"
  station_pid=$(property clampd MainPID)
  wait "$check_pid" && fail "$name: the check that was cut off ended well"
  stop_recording
  expect_levels "$name" relay=0
  wait_for_idle
  check "$id" 2
  expect_pass "$id"
  echo "ok: $name: the new process checks the brake"
}

service_hangs() {
  begin_fault "service hangs"
  wait_until 20 "the brake is clamped" clamped
  restarts=$(property clampd NRestarts)
  expect_relay_drops kill -STOP "$station_pid"
  sleep 10
  expect_restarted
  expect "$name: it was the watchdog" in_journal "Watchdog timeout"
}

service_killed() {
  begin_fault "service killed"
  wait_until 20 "the brake is clamped" clamped
  restarts=$(property clampd NRestarts)
  expect_relay_drops kill -KILL "$station_pid"
  expect_restarted
}

waits_for_its_panel
poll_s=0.02 # the brake is clamped for 0.3 s
emergency_stop_of_running_station
sed -i 's/^clearance_rad = 30$/clearance_rad = 6/' /etc/clampd/station.toml # from its next start on
emergency_stop_in_init
lines_pulled_in_a_check
chip_removed
service_hangs
service_killed
