#include "rt/reading_monitor.hpp"

#include <cmath>
#include <functional>
#include <optional>

#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"

namespace clampd::rt {
namespace {

/// A brake of the nominal kind, its readings free of noise, and a monitor that looks on.
class MovingBrake {
 public:
  explicit MovingBrake(double position_rad = -20.0) : position_rad_(position_rad) {}

  /// One sample, after which `torque_Nm` acts; `spoil` may change what the monitor sees of it.
  FaultCause sample(double torque_Nm, const std::function<void(BrakeFeedback&)>& spoil = {}) {
    monitor_.commanded(told_rad_s ? DriveCommand{.velocity_rad_s = *told_rad_s,
                                                 .commanded = CommandedQuantity::Velocity}
                                  : DriveCommand{.torque_Nm = torque_Nm});
    BrakeFeedback feedback;
    feedback.sample_index = index_++;
    feedback.torque_Nm = torque_Nm;
    feedback.velocity_rad_s = velocity_rad_s_;
    feedback.position_rad = position_rad_;
    feedback.force_N = force_N();
    if (spoil) spoil(feedback);
    const FaultCause cause = monitor_.observe(feedback, context);
    advance(torque_Nm);
    return cause;
  }

  /// So many samples; the first cause, and after how many it came.
  FaultCause samples(int count, double torque_Nm, const std::function<void(BrakeFeedback&)>& spoil = {}) {
    for (taken = 1; taken <= count; ++taken)
      if (const FaultCause cause = sample(torque_Nm, spoil); cause != FaultCause::None) return cause;
    return FaultCause::None;
  }

  double force_N() const {
    const double x = std::max(0.0, position_rad_);
    return (drive_.cubic_N_rad3 * x + drive_.quadratic_N_rad2) * x * x;
  }
  double velocity_rad_s() const { return velocity_rad_s_; }
  double position_rad() const { return position_rad_; }

  ReadingContext context;
  std::optional<double> told_rad_s;  ///< in place of the torque
  int taken = 0;

 private:
  void advance(double torque_Nm) {
    constexpr int kSteps = 50;
    const double h = kPeriod_s / kSteps;
    for (int i = 0; i < kSteps; ++i) {
      const double friction_Nm = drive_.dry_friction_Nm(std::abs(velocity_rad_s_), force_N()) +
                                 drive_.viscous_Nm_s_rad * std::abs(velocity_rad_s_);
      const double free =
          velocity_rad_s_ + h / drive_.inertia_kg_m2 * (torque_Nm - drive_.ratio_m_rad * force_N());
      const double slip = std::max(0.0, std::abs(free) - h / drive_.inertia_kg_m2 * friction_Nm);
      velocity_rad_s_ = std::copysign(slip, free);
      position_rad_ += h * velocity_rad_s_;
    }
  }

  NominalDrive drive_;
  ReadingMonitor monitor_{ReadingTolerances{}, drive_, 3.1};
  std::int64_t index_ = 0;
  double position_rad_;
  double velocity_rad_s_ = 0.0;
};

TEST(ReadingMonitor, AHealthyBrakeMayMoveAsItCan) {
  MovingBrake bench;
  for (const double torque_Nm : {0.0, 0.05, 1.0, 3.0, -3.0, 0.0, 2.0, 0.5, -1.0, 0.0})
    ASSERT_EQ(bench.samples(50, torque_Nm), FaultCause::None) << torque_Nm << " N m, sample " << bench.taken;
  EXPECT_GT(bench.velocity_rad_s() * bench.velocity_rad_s() + bench.force_N(), 1.0) << "it must have moved";
}

TEST(ReadingMonitor, NamesTheReadingThatFreezesInMotion) {
  struct Case {
    double BrakeFeedback::*reading;
    FaultCause cause;
    int within;
  };
  for (const auto& [reading, cause, within] :
       {Case{&BrakeFeedback::velocity_rad_s, FaultCause::VelocityReading, 25},
        Case{&BrakeFeedback::position_rad, FaultCause::PositionReading, 12}}) {
    MovingBrake bench;
    ASSERT_EQ(bench.samples(30, 1.0), FaultCause::None);
    double held = 0.0;
    bench.sample(1.0, [&, member = reading](BrakeFeedback& f) { held = f.*member; });
    EXPECT_EQ(bench.samples(100, 1.0, [&, member = reading](BrakeFeedback& f) { f.*member = held; }), cause);
    EXPECT_LE(bench.taken, within) << to_string(cause);
  }
}

TEST(ReadingMonitor, AFrozenEncoderIsFoundByTheTorque) {
  MovingBrake bench;
  ASSERT_EQ(bench.samples(10, 0.0), FaultCause::None);
  const double begin_rad = bench.position_rad();
  EXPECT_EQ(bench.samples(100, 3.0,
                          [&](BrakeFeedback& f) {
                            f.position_rad = begin_rad;
                            f.velocity_rad_s = 0.0;
                          }),
            FaultCause::TorqueAgainstMotion);
  EXPECT_LT(bench.velocity_rad_s(), 100.0);
}

TEST(ReadingMonitor, MotionWithoutTorqueIsFoundToo) {
  MovingBrake bench;
  ASSERT_EQ(bench.samples(10, 0.0), FaultCause::None);
  double extra_rad_s = 0.0, extra_rad = 0.0;
  EXPECT_EQ(bench.samples(100, 0.0,
                          [&](BrakeFeedback& f) {
                            extra_rad += (extra_rad_s + 1.0) * kPeriod_s;
                            extra_rad_s += 2.0;
                            f.velocity_rad_s += extra_rad_s;
                            f.position_rad += extra_rad;
                          }),
            FaultCause::TorqueAgainstMotion);
}

TEST(ReadingMonitor, TheOpenStopMayHoldWhatOpensGently) {
  const auto stand = [](BrakeFeedback& f) {
    f.position_rad = -26.0;
    f.velocity_rad_s = 0.0;
  };
  MovingBrake bench;
  bench.context.stop_ahead = true;
  EXPECT_EQ(bench.samples(200, -1.0, stand), FaultCause::None);
  MovingBrake elsewhere;
  EXPECT_EQ(elsewhere.samples(200, -1.0, stand), FaultCause::TorqueAgainstMotion);
}

TEST(ReadingMonitor, NamesATorqueThatWasNotCommanded) {
  MovingBrake bench;
  EXPECT_EQ(bench.samples(100, 1.0, [](BrakeFeedback& f) { f.torque_Nm = -1.0; }), FaultCause::TorqueReading);
  EXPECT_LE(bench.taken, 10);
  MovingBrake tolerant;
  EXPECT_EQ(tolerant.samples(100, 1.0, [](BrakeFeedback& f) { f.torque_Nm *= 1.1; }), FaultCause::None);
}

/// Clamps to 8 kN and goes on moving.
void clamp_to_8_kN(MovingBrake& bench) {
  while (bench.force_N() < 8e3) ASSERT_EQ(bench.sample(1.2), FaultCause::None);
  ASSERT_GT(bench.velocity_rad_s(), 50.0);
}

TEST(ReadingMonitor, NamesAForceThatDoesNotFollowTheCompression) {
  MovingBrake frozen(-1.0);
  clamp_to_8_kN(frozen);
  const double held_N = frozen.force_N();
  EXPECT_EQ(frozen.samples(100, 0.0, [&](BrakeFeedback& f) { f.force_N = held_N; }),
            FaultCause::ForceReading);
  EXPECT_LE(frozen.taken, 10);
  MovingBrake silent(-1.0);
  clamp_to_8_kN(silent);
  EXPECT_EQ(silent.samples(100, 0.0, [&](BrakeFeedback& f) { f.force_N = 0.0; }), FaultCause::ForceReading);
  EXPECT_LE(silent.taken, 5);
}

TEST(ReadingMonitor, AForceThatNeverComesIsMissed) {
  const auto silence = [](BrakeFeedback& f) { f.force_N = 35.0; };
  MovingBrake approach(-1.0);  // contact not known: the torque that it takes tells
  FaultCause cause = FaultCause::None;
  for (int i = 0; i < 3000 && cause == FaultCause::None; ++i)
    cause = approach.sample(approach.velocity_rad_s() < 20.0 ? 0.8 : 0.1, silence);
  EXPECT_EQ(cause, FaultCause::ForceReading);
  EXPECT_LT(approach.force_N(), 20e3);

  MovingBrake run(-1.0);
  run.context.contact_known = true;
  EXPECT_EQ(run.samples(400, 1.2, silence), FaultCause::ForceReading);
  EXPECT_LT(run.force_N(), 15e3);
}

TEST(ReadingMonitor, AnOutlierOfTheForceIsNoFault) {
  MovingBrake bench(-1.0);
  for (int i = 0; i < 200; ++i)
    ASSERT_EQ(bench.sample(1.0, [&](BrakeFeedback& f) { f.force_N += i % 10 == 0 ? 2000.0 : 0.0; }),
              FaultCause::None)
        << i;
}

TEST(ReadingMonitor, ASpeedThatIsNotTakenUpIsNamedInABoundedTime) {
  for (const double told_rad_s : {20.0, -30.0, 220.0, -220.0}) {
    MovingBrake bench;
    bench.told_rad_s = told_rad_s;
    EXPECT_EQ(bench.samples(200, 0.0), FaultCause::SpeedNotFollowed) << told_rad_s;
    EXPECT_LE(bench.taken, 60) << told_rad_s;
  }
  // It runs on, though told to stand.
  MovingBrake bench(-40.0);
  ASSERT_EQ(bench.samples(20, 2.0), FaultCause::None);
  bench.told_rad_s = 0.0;
  const double coasting_Nm = 0.12;
  EXPECT_EQ(bench.samples(200, coasting_Nm), FaultCause::SpeedNotFollowed);
  EXPECT_LE(bench.taken, 60);
}

TEST(ReadingMonitor, ASpeedMayBeTakenUpAsFastAsTheTorqueAllows) {
  MovingBrake bench(-60.0);
  for (const double told_rad_s : {220.0, 0.0, -30.0, 220.0, 120.0, 0.0}) {
    bench.told_rad_s = told_rad_s;
    for (int k = 0; k < 120; ++k) {
      const double torque_Nm = std::clamp(0.1 * (told_rad_s - bench.velocity_rad_s()), -2.5, 2.5);
      ASSERT_EQ(bench.sample(torque_Nm), FaultCause::None) << told_rad_s << " rad/s, sample " << k;
    }
  }
}

TEST(ReadingMonitor, WhereABrakeFollowsItsSpeedTheTorqueReadingIsWrong) {
  MovingBrake bench(-60.0);
  bench.context.contact_known = true;
  bench.told_rad_s = 100.0;
  FaultCause cause = FaultCause::None;
  for (int k = 0; k < 400 && cause == FaultCause::None; ++k)
    cause = bench.sample(std::clamp(0.1 * (100.0 - bench.velocity_rad_s()), -2.5, 2.5),
                         [&](BrakeFeedback& f) { f.torque_Nm += k > 60 ? 1.0 : 0.0; });
  EXPECT_EQ(cause, FaultCause::TorqueReading);
}

TEST(RepeatWatch, LearnsHowOftenANoisyReadingRepeatsItself) {
  RepeatWatch watch;
  for (int i = 0; i < 300; ++i) EXPECT_FALSE(watch.repeats_too_often(i % 7 == 0 ? 0.0 : i, true));
  int held = 0;
  while (held < 1000 && !watch.repeats_too_often(5.0, false)) ++held;
  EXPECT_LE(held, 12);

  RepeatWatch silent;  // a sensor without noise says the same at rest for ever
  for (int i = 0; i < 5000; ++i) ASSERT_FALSE(silent.repeats_too_often(0.0, i < 500));
}

}  // namespace
}  // namespace clampd::rt
