#include "rt/readiness.hpp"

#include <algorithm>
#include <filesystem>

#include <gtest/gtest.h>

#include "support/temporary_directory.hpp"

namespace clampd::rt {
namespace {

/// A made-up /proc and /sys.
class Readiness : public ::testing::Test {
 protected:
  void SetUp() override { options_.root = directory_.path(""); }

  void write(const std::string& path, const std::string& content) {
    std::filesystem::create_directories(std::filesystem::path(options_.root + path).parent_path());
    directory_.write(path.substr(1), content + "\n");
  }
  ReadinessFact fact(const std::string& name) const {
    const auto facts = examine_readiness(options_);
    const auto found =
        std::find_if(facts.begin(), facts.end(), [&](const auto& f) { return f.name == name; });
    if (found != facts.end()) return *found;
    ADD_FAILURE() << "no fact " << name;
    return {};
  }

  support::TemporaryDirectory directory_;
  ReadinessOptions options_;
};

TEST_F(Readiness, KnowsARealTimeKernel) {
  EXPECT_EQ(fact("kernel preemption").status, ReadinessStatus::Warn);
  write("/sys/kernel/realtime", "1");
  EXPECT_EQ(fact("kernel preemption").status, ReadinessStatus::Ok);
}

TEST_F(Readiness, ACapabilityReplacesTheResourceLimit) {
  // CAP_SYS_NICE is bit 23, CAP_IPC_LOCK bit 14.
  write("/proc/self/status", "Name:\tx\nCapEff:\t0000000000804000");
  EXPECT_EQ(fact("right to real-time priority").status, ReadinessStatus::Ok);
  EXPECT_EQ(fact("right to lock memory").status, ReadinessStatus::Ok);
}

TEST_F(Readiness, JudgesThrottling) {
  write("/proc/sys/kernel/sched_rt_runtime_us", "-1");
  EXPECT_EQ(fact("real-time throttling").status, ReadinessStatus::Ok);
  EXPECT_EQ(fact("real-time throttling").advice, "");
  write("/proc/sys/kernel/sched_rt_runtime_us", "0");
  EXPECT_EQ(fact("real-time throttling").status, ReadinessStatus::Fail);
}

TEST_F(Readiness, WantsTheStationOnAnIsolatedCore) {
  EXPECT_EQ(fact("isolated cores").status, ReadinessStatus::Warn);
  write("/sys/devices/system/cpu/isolated", "3");
  EXPECT_EQ(fact("isolated cores").status, ReadinessStatus::Warn);
  options_.cpu = 3;
  EXPECT_EQ(fact("isolated cores").status, ReadinessStatus::Ok);
}

TEST_F(Readiness, JudgesGovernorAndClockSource) {
  write("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "powersave");
  write("/sys/devices/system/clocksource/clocksource0/current_clocksource", "hpet");
  EXPECT_EQ(fact("frequency governor").status, ReadinessStatus::Warn);
  EXPECT_EQ(fact("clock source").status, ReadinessStatus::Warn);
  write("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance");
  write("/sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc");
  EXPECT_EQ(fact("frequency governor").status, ReadinessStatus::Ok);
  EXPECT_EQ(fact("clock source").status, ReadinessStatus::Ok);
}

TEST_F(Readiness, NothingIsLeftWithoutAdviceOrWords) {
  options_.root.clear();  // this machine
  options_.jitter_test_ns = 30'000'000;
  const auto facts = examine_readiness(options_);
  EXPECT_EQ(facts.back().name, "wake-up lateness");
  for (const auto& one : facts) {
    EXPECT_NE(one.found, "") << one.name;
    if (one.status != ReadinessStatus::Ok) {
      EXPECT_NE(one.advice, "") << one.name;
    }
  }
}

}  // namespace
}  // namespace clampd::rt
