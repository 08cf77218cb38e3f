// Station and brake over the embedded bus, in virtual time: the order of events within a sample, the faults,
// and the promise that no tick allocates.

#include "drivers/can/can_brake.hpp"

#include <gtest/gtest.h>

#include <array>
#include <optional>
#include <vector>

#include "clampd/base/clock.hpp"
#include "drivers/can/brake_codec.hpp"
#include "drivers/can/brake_node.hpp"
#include "drivers/can/embedded_bus.hpp"
#include "support/allocation_trap.hpp"

namespace clampd::can {
namespace {

/// A motor without a brake: reports the torque it was told, counts what it was told.
class ToyBrake {
 public:
  void command(const DriveCommand& command) noexcept {
    newest_ = command;
    ++commands_;
  }

  BrakeFeedback sample() noexcept {
    BrakeFeedback reading;
    reading.brake_time_ns = samples_++ * kPeriod_ns;
    reading.torque_Nm = newest_.enable ? newest_.torque_Nm : 0.0;
    reading.force_N = static_cast<double>(samples_ % 1000);
    reading.drive_enabled = newest_.enable;
    return reading;
  }

  int commands() const { return commands_; }

 private:
  DriveCommand newest_;
  int commands_ = 0;
  std::int64_t samples_ = 0;
};

class Bench : public ::testing::Test {
 protected:
  /// One millisecond: the brake samples on its grid, the station answers half a period later.
  std::optional<BrakeFeedback> step(const DriveCommand& command, WireFault fault = WireFault::None) {
    acting_ = node_.tick(now_ns_, fault);
    now_ns_ += kPeriod_ns / 2;
    std::array<BrakeFeedback, 4> samples;
    const std::size_t count = port_.receive(samples, now_ns_);
    port_.send(command, now_ns_);
    now_ns_ += kPeriod_ns / 2;
    return count == 0 ? std::nullopt : std::optional{samples[count - 1]};
  }

  void run(int ticks, const DriveCommand& command, WireFault fault = WireFault::None) {
    for (int i = 0; i < ticks; ++i) step(command, fault);
  }

  ProtocolCodec codec_ = brake_codec();
  EmbeddedBus bus_{1e6};
  CanBrake port_{bus_.end(EmbeddedBus::End::Station), codec_};
  ToyBrake brake_;
  BrakeNode<ToyBrake> node_{bus_.end(EmbeddedBus::End::Brake), codec_, brake_};
  BrakeFeedback acting_;
  std::int64_t now_ns_ = 1'000'000'000;
};

TEST_F(Bench, TheAnswerToASampleActsFromTheNextOneOn) {
  run(3, {0.0, true});
  for (int k = 0; k < 50; ++k) {
    const double torque_Nm = 0.01 * k;
    const auto feedback = step({torque_Nm, true});
    ASSERT_TRUE(feedback);
    EXPECT_EQ(feedback->sample_index, k + 3);
    EXPECT_EQ(feedback->brake_time_ns, (k + 3) * kPeriod_ns);
    EXPECT_NEAR(feedback->torque_Nm, k == 0 ? 0.0 : 0.01 * (k - 1), 1e-9);
  }
}

TEST_F(Bench, TenThousandTicksAllocateNothingAndLoseNothing) {
  run(5, {0.0, false});
  std::size_t samples = 0;
  std::size_t allocations = 0;
  std::size_t releases = 0;
  {
    const support::AllocationTrap trap;
    for (int i = 0; i < 10'000; ++i) samples += step({0.5, true}) ? 1U : 0U;
    // Refusals take other branches of the same path.
    run(10, {0.5, true}, WireFault::CorruptCrc);
    run(10, {0.5, true}, WireFault::FrozenCounter);
    run(10, {0.5, true}, WireFault::ImpossibleValues);
    run(10, {0.5, true}, WireFault::Silent);
    allocations = trap.allocations();
    releases = trap.releases();
  }
  EXPECT_EQ(allocations, 0U);
  EXPECT_EQ(releases, 0U);
  EXPECT_EQ(samples, 10'000U);
}

TEST_F(Bench, MeasuredBusLoadIsTheBudgeted) {
  const std::uint64_t before = port_.health().bus_bits;
  run(1000, {0.1, true});
  const std::uint64_t bits = port_.health().bus_bits - before;
  // The last command is not on the brake's side yet, but the station counts what it sent.
  EXPECT_EQ(bits, 1000U * static_cast<std::uint64_t>(codec_.bits_per_period()));
  EXPECT_LT(static_cast<double>(bits) / 1e6, 0.42) << "of a second at 1 Mbit/s";
}

TEST_F(Bench, WireFaultsShowInTheHealthUnderTheirNames) {
  run(10, {0.0, true});
  PortHealth before = port_.health();
  EXPECT_EQ(before.crc_errors + before.counter_errors + before.implausible + before.lost_samples, 0U);
  run(5, {0.0, true}, WireFault::CorruptCrc);
  EXPECT_EQ(port_.health().crc_errors, 10U);
  run(1, {0.0, true});
  EXPECT_EQ(port_.health().lost_samples, 5U);
  run(5, {0.0, true}, WireFault::ImpossibleValues);
  EXPECT_EQ(port_.health().implausible, 5U);
  run(1, {0.0, true});
  run(5, {0.0, true}, WireFault::FrozenCounter);
  EXPECT_EQ(port_.health().counter_errors, 10U);
  run(30, {0.0, true}, WireFault::Silent);
  const std::uint64_t lost = port_.health().lost_samples;
  EXPECT_TRUE(step({0.0, true}) || step({0.0, true})) << "recovers by itself";
  EXPECT_GT(port_.health().lost_samples, lost);
}

TEST_F(Bench, ALostCommandLeavesTheLastOneActing) {
  run(5, {0.25, true});
  bus_.drop_next(EmbeddedBus::End::Station, 1);
  run(1, {0.75, true});
  step({0.5, true});
  EXPECT_NEAR(acting_.torque_Nm, 0.25, 1e-9);
  step({0.5, true});
  EXPECT_NEAR(acting_.torque_Nm, 0.5, 1e-9);
}

TEST_F(Bench, ACorruptCommandNeverReachesTheBrake) {
  run(5, {0.25, true});
  const int commands = brake_.commands();
  bus_.corrupt_next(EmbeddedBus::End::Station, 3);
  run(3, {1.0, true});
  step({0.25, true});
  EXPECT_EQ(brake_.commands() - commands, 1) << "only the one sent before the three";
  EXPECT_EQ(node_.counts().crc_errors, 3U);
  EXPECT_NEAR(acting_.torque_Nm, 0.25, 1e-9);
}

class LinkLoss : public Bench, public ::testing::WithParamInterface<LinkState> {};

TEST_P(LinkLoss, TheBrakesOwnLinkLossIsZeroTorqueAtOnceAndStaysUntilDisabled) {
  run(10, {0.5, true});
  ASSERT_NEAR(acting_.torque_Nm, 0.5, 1e-9);
  bus_.set_link(GetParam());
  EXPECT_FALSE(step({0.5, true}));
  EXPECT_EQ(acting_.torque_Nm, 0.0) << "at the very next sample";
  EXPECT_EQ(port_.health().link, GetParam());
  EXPECT_GT(port_.health().send_failures, 0U);

  bus_.set_link(LinkState::Up);
  run(10, {0.5, true});
  EXPECT_EQ(acting_.torque_Nm, 0.0) << "torque never returns by itself";
  EXPECT_TRUE(acting_.brake_fault);
  run(2, {0.0, false});
  run(2, {0.5, true});
  EXPECT_NEAR(acting_.torque_Nm, 0.5, 1e-9);
  EXPECT_FALSE(acting_.brake_fault);
}

INSTANTIATE_TEST_SUITE_P(EveryWay, LinkLoss,
                         ::testing::Values(LinkState::Down, LinkState::Gone, LinkState::BusOff),
                         [](const auto& state) {
                           std::string name{to_string(state.param)};
                           std::erase(name, '-');
                           return name;
                         });

TEST_F(Bench, ABusOffThatIsOverBeforeTheNextSampleStillCounts) {
  run(10, {0.5, true});
  bus_.set_link(LinkState::BusOff);
  bus_.set_link(LinkState::Up);
  step({0.5, true});
  EXPECT_EQ(acting_.torque_Nm, 0.0);
  EXPECT_EQ(port_.health().bus_off_events, 1U);
}

TEST_F(Bench, AFloodedBusDoesNotHoldTheTick) {
  run(5, {0.0, false});
  FrameBus& babbler = bus_.end(EmbeddedBus::End::Brake);
  for (int i = 0; i < 200; ++i) babbler.send(codec_.feedback[0].blank(), now_ns_);
  now_ns_ += 100 * kPeriod_ns;
  const std::uint64_t before = port_.health().frames_received;
  std::array<BrakeFeedback, 4> samples;
  EXPECT_EQ(port_.receive(samples, now_ns_), 0U);
  EXPECT_EQ(port_.health().frames_received - before, static_cast<std::uint64_t>(kFramesPerTick));
}

TEST_F(Bench, WhatPiledUpBeforeTheFirstTickIsNotLookedAt) {
  for (int i = 0; i < 20; ++i) {
    node_.tick(now_ns_);
    now_ns_ += kPeriod_ns;
  }
  std::array<BrakeFeedback, 8> samples;
  EXPECT_EQ(port_.receive(samples, now_ns_), 1U);
  EXPECT_EQ(samples[0].sample_index, 0);
  EXPECT_EQ(samples[0].brake_time_ns, 19 * kPeriod_ns);
}

TEST_F(Bench, ASmallBufferLeavesTheRestForTheNextCall) {
  step({0.0, false});
  for (int i = 0; i < 3; ++i) {
    node_.tick(now_ns_);
    now_ns_ += kPeriod_ns;
  }
  std::array<BrakeFeedback, 2> samples;
  EXPECT_EQ(port_.receive(samples, now_ns_), 2U);
  EXPECT_EQ(samples[1].sample_index, 2);
  EXPECT_EQ(port_.receive(samples, now_ns_), 1U);
  EXPECT_EQ(samples[0].sample_index, 3);
}

}  // namespace
}  // namespace clampd::can
