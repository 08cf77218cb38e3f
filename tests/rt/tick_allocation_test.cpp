#include <cstdlib>
#include <limits>
#include <memory>
#include <string>

#include <gtest/gtest.h>

#include "rt/toy_station.hpp"
#include "support/allocation_trap.hpp"

namespace clampd::rt::test {
namespace {

using support::AllocationTrap;

TEST(AllocationTrap, CatchesPlantedAllocations) {
  AllocationTrap trap;
  auto* volatile number = new int(1);
  EXPECT_EQ(trap.allocations(), 1U);
  delete number;
  EXPECT_EQ(trap.releases(), 1U);
  void* volatile block = std::malloc(100);
  std::free(block);
  EXPECT_EQ(trap.allocations(), 2U);
  void* volatile zeroed = std::calloc(3, 7);
  std::free(zeroed);
  EXPECT_EQ(trap.allocations(), 3U);
  struct alignas(128) Wide {
    double value = 0.0;
  };
  auto* volatile wide = new Wide;
  delete wide;
  EXPECT_EQ(trap.allocations(), 4U);
  const std::string text(200, 'x');
  EXPECT_EQ(trap.allocations(), 5U);
}

TEST(AllocationTrap, SeesOnlyItsOwnLifetime) {
  const auto outside = std::make_unique<int>(1);
  AllocationTrap trap;
  EXPECT_EQ(trap.allocations(), 0U);
  EXPECT_EQ(trap.releases(), 0U);
}

// Checks, faults of several kinds, clears, a full ring, a slow and a fast consumer.
TEST(Tick, NeverAllocates) {
  ToyStation station({}, 256);
  std::uint64_t checks = 0;
  std::uint64_t faults = 0;
  bool in_fault = false;
  std::size_t allocations = 0;
  std::size_t releases = 0;
  {
    AllocationTrap trap;
    for (int i = 0; i < 12'000; ++i) {
      ToyPort& port = station.port;
      RequestBoard& requests = station.core.requests();
      port.samples_per_tick = i % 7 == 0 ? 2 : 1;
      port.silent = i % 1500 > 1490;
      port.send_fails = i % 2500 > 2490;
      if (i % 1100 == 1000) ++port.counts.crc_errors;
      if (i % 1700 == 1600) ++port.counts.bus_off_events;
      ToySequence::torque_Nm = i % 900 == 899 ? std::numeric_limits<double>::quiet_NaN() : 0.5;
      if (i % 2100 == 2000) station.stop();
      if (station.state() == StationState::Idle) {
        station.plan.commanded = i % 2 == 0 ? CommandedQuantity::Torque : CommandedQuantity::Velocity;
        ToySequence::velocity_rad_s = i % 2 == 0 ? 0.0 : 5.0;
        station.start();
      }
      if (station.core.status().clearable) requests.clear = true;
      station.tick(i % 400 == 399 ? 1 : 0);
      Sample sample;
      if (i % 3 == 0) station.core.ring().pop(sample);
      faults += station.state() == StationState::Fault && !in_fault;
      in_fault = station.state() == StationState::Fault;
    }
    station.core.shutdown(station.now_ns);
    allocations = trap.allocations();
    releases = trap.releases();
  }
  checks = station.core.status().checks_finished;
  EXPECT_EQ(allocations, 0U);
  EXPECT_EQ(releases, 0U);
  EXPECT_GT(checks, 20U);
  EXPECT_GT(faults, 20U);
  EXPECT_GT(station.core.status().ring_drops, 1000U);
}

}  // namespace
}  // namespace clampd::rt::test
