#include "drivers/can/protocol.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "clampd/base/clock.hpp"
#include "drivers/can/brake_codec.hpp"

namespace clampd::can {
namespace {

/// Both ends and the frames between them, one sample after the other.
class Protocol : public ::testing::Test {
 protected:
  std::vector<Frame> next_sample(WireFault fault = WireFault::None) {
    now_ns_ += kPeriod_ns;
    clock_ns_ += kPeriod_ns;
    BrakeFeedback reading = reading_;
    reading.brake_time_ns = clock_ns_;
    std::array<Frame, kMaxFeedbackFrames> frames;
    const std::size_t count = brake_.feedback(reading, frames, fault);
    return {frames.begin(), frames.begin() + static_cast<std::ptrdiff_t>(count)};
  }

  std::optional<BrakeFeedback> deliver(const std::vector<Frame>& frames) {
    std::optional<BrakeFeedback> result;
    for (const Frame& frame : frames) {
      if (const auto feedback = station_.accept(frame, now_ns_)) {
        EXPECT_FALSE(result) << "two samples from the frames of one";
        result = feedback;
      }
    }
    return result;
  }

  ProtocolCodec codec_ = brake_codec();
  StationProtocol station_{codec_};
  BrakeProtocol brake_{codec_};
  BrakeFeedback reading_{0, 0, 0, 1.2345, -56.78, 23456.0, 12.345, true, false, false};
  std::int64_t now_ns_ = 5'000'000'000;
  std::int64_t clock_ns_ = 700'000'000;
};

/// A brake that samples four times in a period.
class FasterBrake : public ::testing::Test {
 protected:
  FasterBrake() : codec_(brake_codec()) {
    codec_.samples_per_period = 4;
    station_.emplace(codec_);
    brake_.emplace(codec_);
  }
  /// One sample, whose readings are its number (of the torque, thousandths).
  std::optional<BrakeFeedback> sample(bool arrives = true, bool fault = false) {
    ++count_;
    BrakeFeedback reading;
    reading.torque_Nm = 0.001 * count_;
    reading.force_N = count_;
    reading.drive_enabled = true;
    reading.brake_fault = fault;
    reading.brake_time_ns = 700'000'000 + count_ * codec_.feedback_cycle_ns();
    std::array<Frame, kMaxFeedbackFrames> frames;
    const std::size_t frame_count = brake_->feedback(reading, frames);
    std::optional<BrakeFeedback> result;
    for (std::size_t i = 0; arrives && i < frame_count; ++i)
      if (const auto feedback = station_->accept(frames[i], reading.brake_time_ns)) result = feedback;
    return result;
  }
  ProtocolCodec codec_;
  std::optional<StationProtocol> station_;
  std::optional<BrakeProtocol> brake_;
  int count_ = 0;
};

TEST_F(FasterBrake, APeriodHasTheFirstReadingsAndTheMeanTorque) {
  for (int period = 0; period < 100; ++period) {
    for (int i = 0; i < 3; ++i) EXPECT_FALSE(sample(true, period == 7 && i == 1));
    const auto whole = sample();
    ASSERT_TRUE(whole) << period;
    EXPECT_EQ(whole->sample_index, period);
    EXPECT_NEAR(whole->force_N, 4.0 * period + 1.0, 0.5);
    EXPECT_NEAR(whole->torque_Nm, 0.001 * (4.0 * period + 2.5), 1e-4);
    EXPECT_EQ(whole->brake_time_ns, 700'000'000 + period * kPeriod_ns + codec_.feedback_cycle_ns());
    EXPECT_EQ(whole->brake_fault, period == 7) << "said by any of them";
  }
  EXPECT_EQ(station_->counts().lost_samples, 0U);
}

/// The torque changes with each third sample of what are periods at first.
TEST_F(FasterBrake, PeriodsBeginWhereCommandsTakeEffect) {
  std::mt19937_64 random(6);
  std::normal_distribution<double> torque_Nm(0.0, 0.3), noise_Nm(0.0, 0.01);
  BrakeFeedback reading;
  std::int64_t index = -1, time_ns = 0;
  int uneven = 0, rows = 0;
  double acting_Nm = 0.0;
  for (int k = 0; k < 4000; ++k) {
    if (k % 4 == 2) acting_Nm = std::clamp(torque_Nm(random), -3.0, 3.0);
    reading.torque_Nm = acting_Nm + noise_Nm(random);
    reading.force_N = 10.0 * (k % 4);
    reading.brake_time_ns = 700'000'000 + k * codec_.feedback_cycle_ns();
    std::array<Frame, kMaxFeedbackFrames> frames;
    const std::size_t count = brake_->feedback(reading, frames);
    std::optional<BrakeFeedback> whole;
    for (std::size_t i = 0; i < count; ++i)
      if (const auto feedback = station_->accept(frames[i], reading.brake_time_ns)) whole = feedback;
    if (!whole) continue;
    ++rows;
    EXPECT_EQ(whole->sample_index, index + 1);
    if (index >= 0) {
      EXPECT_EQ(whole->brake_time_ns, time_ns + kPeriod_ns);
    }
    index = whole->sample_index;
    time_ns = whole->brake_time_ns;
    uneven += std::abs(whole->force_N - 20.0) > 1.0 ? 1 : 0;
    if (k > 400) {
      EXPECT_NEAR(whole->torque_Nm, acting_Nm, 0.03) << k;
    }
  }
  EXPECT_GT(rows, 990);
  EXPECT_LT(uneven, 20);
  EXPECT_GT(uneven, 0);
  EXPECT_EQ(station_->counts().lost_samples, 0U);
}

TEST_F(FasterBrake, APeriodThatIsNotWholeIsLost) {
  for (int i = 0; i < 4; ++i) sample();
  for (int lost = 0; lost < 4; ++lost) {
    int whole = 0;
    for (int i = 0; i < 4; ++i) whole += sample(i != lost) ? 1 : 0;
    EXPECT_EQ(whole, 0) << lost;
    for (int i = 0; i < 4; ++i) whole += sample() ? 1 : 0;
    EXPECT_EQ(whole, 1) << lost;
  }
  EXPECT_EQ(station_->counts().lost_samples, 4U);
  EXPECT_EQ(station_->counts().counter_errors, 0U);
}

TEST_F(Protocol, ASampleArrivesAsItWasTaken) {
  const auto first = deliver(next_sample());
  ASSERT_TRUE(first);
  EXPECT_EQ(first->sample_index, 0);
  EXPECT_EQ(first->brake_time_ns, clock_ns_);
  EXPECT_EQ(first->arrival_time_ns, now_ns_);
  EXPECT_NEAR(first->torque_Nm, 1.2345, 0.5e-4);
  EXPECT_NEAR(first->velocity_rad_s, -56.78, 0.01);
  EXPECT_NEAR(first->force_N, 23456.0, 0.5);
  EXPECT_NEAR(first->position_rad, 12.345, 0.5e-3);
  EXPECT_TRUE(first->drive_enabled);
  EXPECT_FALSE(first->watchdog_tripped);
  EXPECT_FALSE(first->brake_fault);

  reading_.watchdog_tripped = true;
  reading_.drive_enabled = false;
  reading_.brake_fault = true;
  const auto second = deliver(next_sample());
  ASSERT_TRUE(second);
  EXPECT_EQ(second->sample_index, 1);
  EXPECT_TRUE(second->watchdog_tripped);
  EXPECT_TRUE(second->brake_fault);
  EXPECT_FALSE(second->drive_enabled);
}

TEST_F(Protocol, FramesOfASampleMayComeInAnyOrder) {
  auto frames = next_sample();
  std::swap(frames.front(), frames.back());
  EXPECT_TRUE(deliver(frames));
}

TEST_F(Protocol, ClockUnwrapsOverItsWrap) {
  clock_ns_ = ((1LL << 32) - 3) * 1000;
  std::int64_t previous_ns = -1;
  for (int i = 0; i < 10; ++i) {
    const auto feedback = deliver(next_sample());
    ASSERT_TRUE(feedback) << i;
    if (i > 0) {
      EXPECT_EQ(feedback->brake_time_ns - previous_ns, kPeriod_ns);
    }
    previous_ns = feedback->brake_time_ns;
    EXPECT_EQ(feedback->sample_index, i);
  }
  EXPECT_EQ(station_.counts().counter_errors, 0U);
}

TEST_F(Protocol, ALostFrameIsALostSampleAndNothingElse) {
  ASSERT_TRUE(deliver(next_sample()));
  auto frames = next_sample();
  frames.pop_back();
  EXPECT_FALSE(deliver(frames));
  const auto feedback = deliver(next_sample());
  ASSERT_TRUE(feedback);
  EXPECT_EQ(feedback->sample_index, 2);
  EXPECT_EQ(station_.counts().lost_samples, 1U);
  EXPECT_EQ(station_.counts().counter_errors, 0U);
}

TEST_F(Protocol, HalvesOfDifferentSamplesAreNeverJoined) {
  ASSERT_TRUE(deliver(next_sample()));
  const auto one = next_sample();
  const auto two = next_sample();
  EXPECT_FALSE(deliver({one[0], two[1]}));
  EXPECT_TRUE(deliver(next_sample()));
  EXPECT_EQ(station_.counts().lost_samples, 2U);
}

TEST_F(Protocol, LongGapsAreCountedByTheClock) {
  ASSERT_TRUE(deliver(next_sample()));
  for (int i = 0; i < 99; ++i) next_sample();
  const auto feedback = deliver(next_sample());
  ASSERT_TRUE(feedback);
  EXPECT_EQ(feedback->sample_index, 100);
  EXPECT_EQ(station_.counts().lost_samples, 99U);
}

TEST_F(Protocol, CorruptFramesAreRefusedAndCounted) {
  ASSERT_TRUE(deliver(next_sample()));
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(deliver(next_sample(WireFault::CorruptCrc)));
  EXPECT_EQ(station_.counts().crc_errors, 40U);
  const auto feedback = deliver(next_sample());
  ASSERT_TRUE(feedback) << "good frames are taken again at once";
  EXPECT_EQ(feedback->sample_index, 21);
}

TEST_F(Protocol, WrongSizeIsRefused) {
  auto frames = next_sample();
  frames[0].size = 7;
  EXPECT_FALSE(deliver(frames));
  EXPECT_EQ(station_.counts().crc_errors, 1U);
}

TEST_F(Protocol, AFrozenCounterIsRefusedForAsLongAsItLasts) {
  ASSERT_TRUE(deliver(next_sample()));
  for (int i = 0; i < 100; ++i) EXPECT_FALSE(deliver(next_sample(WireFault::FrozenCounter)));
  EXPECT_EQ(station_.counts().counter_errors, 200U);
  // The counter goes on from where it froze, the clock did not freeze: refused once more, then taken.
  int refused = 0;
  while (!deliver(next_sample())) ++refused;
  EXPECT_LE(refused, 1);
}

TEST_F(Protocol, AFrozenClockIsRefused) {
  ASSERT_TRUE(deliver(next_sample()));
  for (int i = 0; i < 20; ++i) {
    clock_ns_ -= kPeriod_ns;
    EXPECT_FALSE(deliver(next_sample()));
  }
  EXPECT_EQ(station_.counts().counter_errors, 20U);
}

TEST_F(Protocol, ARestartedBrakeIsRefusedOnceAndItsTimeStaysMonotonic) {
  const auto before = deliver(next_sample());
  ASSERT_TRUE(before);
  brake_ = BrakeProtocol{codec_};
  clock_ns_ = 0;
  now_ns_ += 3'000'000'000;
  EXPECT_FALSE(deliver(next_sample()));
  EXPECT_EQ(station_.counts().counter_errors, 1U);
  const auto after = deliver(next_sample());
  ASSERT_TRUE(after);
  EXPECT_GT(after->sample_index, before->sample_index);
  EXPECT_GT(after->brake_time_ns, before->brake_time_ns);
}

TEST_F(Protocol, ReplayedOldFramesAreRefused) {
  const auto old = next_sample();
  ASSERT_TRUE(deliver(old));
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(deliver(next_sample()));
  EXPECT_FALSE(deliver(old));
  EXPECT_EQ(station_.counts().counter_errors, 2U);
}

TEST_F(Protocol, ImpossibleValuesAreRefusedUnderAValidCrc) {
  ASSERT_TRUE(deliver(next_sample()));
  EXPECT_FALSE(deliver(next_sample(WireFault::ImpossibleValues)));
  EXPECT_EQ(station_.counts().implausible, 1U);
  EXPECT_EQ(station_.counts().crc_errors, 0U);
}

TEST_F(Protocol, ReadingsThatTheirSignalCannotTellAreRefused) {
  const auto accepts = [&](double BrakeFeedback::*reading, double value) {
    reading_ = {};
    reading_.*reading = value;
    return deliver(next_sample()).has_value();
  };
  EXPECT_TRUE(accepts(&BrakeFeedback::force_N, 0.0));
  EXPECT_TRUE(accepts(&BrakeFeedback::force_N, -3999.0));
  EXPECT_FALSE(accepts(&BrakeFeedback::force_N, -4000.0))
      << "a load cell that has drifted may be anywhere below";
  EXPECT_FALSE(accepts(&BrakeFeedback::force_N, -7000.0));
  EXPECT_FALSE(accepts(&BrakeFeedback::force_N, 60e3));
  EXPECT_FALSE(accepts(&BrakeFeedback::velocity_rad_s, 700.0));
  EXPECT_FALSE(accepts(&BrakeFeedback::torque_Nm, -5.0));
  EXPECT_EQ(station_.counts().implausible, 5U);
}

TEST_F(Protocol, OtherIdentifiersAreIgnored) {
  EXPECT_FALSE(station_.accept(Frame{0x7FF, 8, {}}, now_ns_));
  EXPECT_FALSE(brake_.accept(Frame{0x7FF, 8, {}}, now_ns_));
  EXPECT_EQ(station_.counts().crc_errors, 0U);
  EXPECT_EQ(brake_.counts().crc_errors, 0U);
}

TEST_F(Protocol, CommandsArriveAsTheyWereGiven) {
  for (int i = 0; i < 40; ++i) {
    const double torque_Nm = -2.0 + 0.1 * i;
    const auto command = brake_.accept(station_.command({torque_Nm, true}), now_ns_ += kPeriod_ns);
    ASSERT_TRUE(command) << i;
    EXPECT_NEAR(command->torque_Nm, torque_Nm, 0.5e-4);
    EXPECT_TRUE(command->enable);
  }
}

TEST_F(Protocol, UnusableCommandsGoOutDisabledAtZero) {
  for (const double torque_Nm :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    const auto command = brake_.accept(station_.command({torque_Nm, true}), now_ns_ += kPeriod_ns);
    ASSERT_TRUE(command);
    EXPECT_FALSE(command->enable);
    EXPECT_EQ(command->torque_Nm, 0.0);
  }
  const auto disabled = brake_.accept(station_.command({2.5, false}), now_ns_ += kPeriod_ns);
  ASSERT_TRUE(disabled);
  EXPECT_EQ(disabled->torque_Nm, 0.0) << "a disabled command carries no torque";
}

TEST_F(Protocol, TheBrakeRefusesBadCommands) {
  const Frame first = station_.command({1.0, true});
  EXPECT_TRUE(brake_.accept(first, now_ns_));
  EXPECT_FALSE(brake_.accept(first, now_ns_ += kPeriod_ns)) << "repeated";
  EXPECT_EQ(brake_.counts().counter_errors, 1U);
  Frame corrupt = station_.command({1.0, true});
  corrupt.data[0] ^= 1U;
  EXPECT_FALSE(brake_.accept(corrupt, now_ns_ += kPeriod_ns));
  EXPECT_EQ(brake_.counts().crc_errors, 1U);
  Frame beyond = station_.command({1.0, true});
  codec_.setpoint.set_raw(beyond, 0x7FFF);
  codec_.command.protection.protect(beyond, 2);
  EXPECT_FALSE(brake_.accept(beyond, now_ns_ += kPeriod_ns));
  EXPECT_EQ(brake_.counts().implausible, 1U);
  EXPECT_TRUE(brake_.accept(station_.command({1.0, true}), now_ns_ += kPeriod_ns));
}

}  // namespace
}  // namespace clampd::can
