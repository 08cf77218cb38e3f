#pragma once

#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/reanalysis/jobs.hpp"
#include "clampd/reanalysis/worker.hpp"
#include "publish/servers.hpp"
#include "support/shipped_limits.hpp"

namespace clampd::support {

/// Checks of simulated brakes, each with a serial of its own; brake 3 rubs. Driven once for all tests.
inline const std::vector<CheckRecord>& checks_of_a_station() {
  static const std::vector<CheckRecord> kChecks = [] {
    std::vector<CheckRecord> checks;
    for (int number = 1; number <= 4; ++number) {
      sim::PlantConfiguration brake = bench::plant(static_cast<std::uint64_t>(number));
      if (number == 3) brake.brake.theta[2] *= 2.5;
      bench::PreparedStation prepared = bench::prepared();
      prepared.configuration.check.diagnose = false;
      bench::EmbeddedStation station(std::move(prepared), brake);
      CheckRecord check = station.run_check(bench::request(5), nullptr, nullptr).value();
      check.id = fmt::format("20261121T{:09}Z-00000000", number);
      check.serial = fmt::format("EMB-{:04}", number);
      check.station = number <= 2 ? "north" : "south";
      check.started = fmt::format("2026-11-{:02}T08:00:00.000Z", 20 + number);
      checks.push_back(std::move(check));
    }
    return checks;
  }();
  return kChecks;
}

/// A database with what a station published to it.
class Archive : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const std::string missing = Database::missing(); !missing.empty()) GTEST_SKIP() << missing;
    server = std::make_unique<Database>();
  }

  publish::PostgresqlSettings settings() const {
    publish::PostgresqlSettings settings = server->settings();
    settings.raw_runs = true;
    return settings;
  }
  void publish(const std::vector<CheckRecord>& checks) const {
    publish::WakeEvent wake;
    const auto channel = publish::make_postgresql_channel(settings());
    const Result<void> connected = channel->connect({}, wake);
    ASSERT_TRUE(connected) << connected.error().message;
    std::int64_t sequence = 0;
    for (const CheckRecord& check : checks) {
      const Result<void> sent = channel->send({check, ++sequence, false}, wake);
      ASSERT_TRUE(sent) << sent.error().message;
    }
  }
  /// What the station judged by.
  static reanalysis::Task task() {
    reanalysis::Task task;
    task.limits = shipped_limits();
    return task;
  }
  reanalysis::Jobs jobs() const {
    Result<reanalysis::Jobs> opened = reanalysis::Jobs::open(settings(), true);
    if (!opened) throw std::runtime_error(opened.error().message);
    return std::move(*opened);
  }
  std::int64_t submit(const reanalysis::Task& task, const reanalysis::Selection& selection = {}) const {
    const auto job = jobs().submit("test", task, selection);
    if (!job) throw std::runtime_error(job.error().message);
    return job->id;
  }
  reanalysis::WorkerOptions worker(const std::string& name) const {
    using namespace std::chrono_literals;
    reanalysis::WorkerOptions options;
    options.database = settings();
    options.name = name;
    options.until_empty = true;
    options.pause = 5ms;
    options.backoff = {5ms, 50ms};
    options.say = [name](const std::string& words) { fmt::print("{}: {}\n", name, words); };
    return options;
  }
  std::string ask(const std::string& sql) const { return server->ask(sql); }
  std::string states() const {
    return ask("SELECT string_agg(state, ' ' ORDER BY check_id) FROM clampd.queue");
  }

  std::unique_ptr<Database> server;
};

}  // namespace clampd::support
