#include "faults/station.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "support/eventually.hpp"
#include "support/network.hpp"

namespace clampd::faults {

using support::eventually;

Station::Station(const std::string& more)
    : port_(support::free_port()), client_("127.0.0.1", port_, folder_.path("token")) {
  configuration_ = folder_.write("station.toml", fmt::format(R"([check]
repeats = 1
tare_s = 0.05
[archive]
database = "state/checks.sqlite"
[control]
port = {}
token_file = "token"
[mqtt]
host = "127.0.0.1"
port = {}
{})",
                                                             port_, support::free_port(), more));
}

api::StationStatus Station::start() {
  program_.emplace(std::vector<std::string>{CLAMPD, "--simulated", "--config", configuration_},
                   folder_.path("log"));
  Result<api::StationStatus> status;
  EXPECT_TRUE(eventually([&] { return (status = client_.status()).has_value(); })) << log();
  return status.value_or(api::StationStatus{});
}

bool Station::wait_for_idle() const {
  return eventually([&] {
    const auto status = client_.status();
    return status && status->state == "IDLE";
  });
}

nlohmann::ordered_json Station::finished() const {
  nlohmann::ordered_json record;
  EXPECT_TRUE(eventually([&] {
    const auto progress = client_.progress(false);
    if (!progress || !progress->finished) return false;
    record = progress->record;
    return true;
  })) << log();
  return record;
}

int Station::end(int signal) {
  program_->send(signal);
  return program_->wait();
}

}  // namespace clampd::faults
