# A station as its package installs it, in a Debian with systemd: sourced after bench.sh.

poll_s=0.5 # what polls here starts programs of a real Debian, and idle time costs nothing

quietly() { "$@" >/tmp/command.log 2>&1 || { cat /tmp/command.log; return 1; }; }

apt() { quietly apt-get -y --no-install-recommends -o Dpkg::Options::=--force-confdef -o Dpkg::Options::=--force-confold "$@"; }

property() { systemctl show --value --property "$2" "$1"; }
property_is() { [ "$(property "$1" "$2")" = "$3" ]; }
tried_again() { [ "$(property clampd NRestarts)" -ge 2 ]; }
# More often than $restarts.
restarted() { [ "$(property clampd NRestarts)" -gt "$restarts" ]; }
in_journal() { journalctl --quiet --unit clampd --grep "$1" "${2:---priority=debug}" >/dev/null; }

# As somebody who may use the station.
technician() { runuser -u technician -- "$@"; }

journal_on_failure() { [ $? = 0 ] || { cat /tmp/status.err; journalctl --no-pager --no-hostname --unit 'clampd*' --lines 40; }; }
trap journal_on_failure EXIT


install_station() {
  expect "apt installs the package" apt install ./clampd*.deb
  useradd --groups clampd technician
  sed -i 's/^interface = "can0"/interface = "vcan0"/; s/^name = "station"/name = "virtual-bench"/' /etc/clampd/station.toml
}
