#include "rt/reading_monitor.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

namespace clampd::rt {
namespace {

// Bounds of what a brake of this product may be, as shares of the nominal one, and of what no model knows.
constexpr double kInertiaLower = 0.8, kInertiaUpper = 1.25;
constexpr double kRatioLower = 0.8, kRatioUpper = 1.25;
constexpr double kDryFriction = 1.6, kViscousFriction = 4.0;
constexpr double kStribeckWidth = 1.5;
constexpr double kCoulombLoad_Nm_N = 1e-5;
constexpr double kForceUnknown_N = 1500.0;  // not tared, or late
constexpr double kTorqueUnknown_Nm = 0.1, kTorqueUnknownShare = 0.1;
constexpr double kSurelyMoving_rad_s = 15.0;  // beyond, friction has the sign of the motion
constexpr double kSlopeLower = 0.3, kSlopeUpper = 2.0;
constexpr double kSlopeUnknown_N_rad = 100.0;
constexpr double kTabled_N = 1e5;  // beyond, a stiffness that grows without end is led on
constexpr double kForceLower = 0.45, kForceUpper = 1.6;
constexpr double kContactUnknown_rad = 1.5;
constexpr double kRelaxation = 0.1;  // share of the force that pads may lose at a standstill

constexpr double kTorqueShare = 0.2;
constexpr double kTorqueSamples = 10.0;       // samples at the tolerance that make a contradiction
// Of a brake that is told its speed: the share of its torque limit that surely accelerates it, less what the
// present force takes, and at least; and how far its speed may be from the command for long.
constexpr double kSureTorque = 0.5, kLeastTorque = 0.1;
constexpr double kSpeedTolerance = 0.4, kSpeedShare = 0.1, kSpeedSamples = 10.0;
// A velocity reading may be filtered, and a force reading may lag. Of slow samples, the median of five still
// is that of two samples ago.
constexpr double kVelocityLag_s = 3e-3, kForceLag_s = 5e-3, kLeastForceLag_samples = 2.5;
constexpr double kForceShare = 0.03;
constexpr double kForceJump = 3.0;  // tolerances; so much in one sample is wrong at once, not an outlier
constexpr double kFrozenForce_N = 300.0;  // due, while the reading repeated exactly
constexpr int kFrozenRepeats = 3;
constexpr int kStill = 8;  // equal samples in a row of a reading that stands still

constexpr double kHint = 0.4;  // of a tolerance: no contradiction, but it tells which of two it is

constexpr double kForgetFast = 0.967;  // a sample: 30 ms
constexpr double kForgetSlow = 0.99;   // 100 ms
constexpr double kForgetForce = 0.98;  // 50 ms
constexpr int kBridgedGap = 3;         // samples that may be missing

constexpr int kLearnSamples = 50;  // at rest, before noise counts as known
constexpr int kNoisyRow = 8;       // a longer row of equal readings at rest: too little noise to judge by
constexpr int kRepeatFactor = 5, kRepeatMargin = 5;
constexpr int kSlowRepeatFactor = 3, kSlowRepeatMargin = 3;

/// Of numbers, or of each of a pair: b where one is no number.
template <class Number>
inline Number larger(Number a, Number b) noexcept {
  return a > b ? a : b;
}
template <class Number>
inline Number smaller(Number a, Number b) noexcept {
  return a < b ? a : b;
}

}  // namespace

void RepeatWatch::learn() noexcept {
  learned_ = std::min(learned_ + 1, kMax);
  longest_ = std::max(longest_, repeats_);
  const bool known = learned_ >= kLearnSamples && longest_ <= kNoisyRow;
  const int factor = is_slow_ ? kSlowRepeatFactor : kRepeatFactor;
  const int margin = is_slow_ ? kSlowRepeatMargin : kRepeatMargin;
  tolerated_ = known ? factor * std::max(longest_, 1) + margin : kMax;
}

ReadingMonitor::Bounds::Bounds(const NominalDrive& drive, double force_tolerance_N,
                               double torque_limit_Nm) noexcept
    : nominal(drive.stiffness()),
      ratio_lower_m_rad(kRatioLower * drive.ratio_m_rad),
      ratio_upper_m_rad(kRatioUpper * drive.ratio_m_rad),
      load_friction_Nm_N(kDryFriction * drive.load_friction_Nm_N),
      viscous_Nm_s_rad(kViscousFriction * drive.viscous_Nm_s_rad),
      light_per_kg_m2(1.0 / (kInertiaLower * drive.inertia_kg_m2)),
      heavy_per_kg_m2(1.0 / (kInertiaUpper * drive.inertia_kg_m2)),
      most_torque_Nm(torque_limit_Nm),
      period_s(drive.period_s),
      velocity_lag_s(std::max(kVelocityLag_s, drive.period_s)),
      force_lag_samples(std::max(kForceLag_s / drive.period_s, kLeastForceLag_samples)),
      force_lag_rows(std::min<std::size_t>(kForceLag, std::llround(std::ceil(force_lag_samples - 1e-9)))),
      steep_rad(1e3),
      top_rad(std::numeric_limits<double>::infinity()) {
  NominalDrive sluggish = drive;
  sluggish.coulomb_Nm *= kDryFriction;
  sluggish.static_Nm *= kDryFriction;
  sluggish.stribeck_rad_s *= kStribeckWidth;
  unloaded = sluggish.dry_friction(0.0);
  if (drive.cubic_N_rad3 < 0.0) {
    // A cubic with k1 < 0 turns over; its steepest place is half way, and it is steep enough to a little
    // beyond. Past its top nothing is known but that the force is there.
    top_rad = 2.0 / 3.0 * drive.quadratic_N_rad2 / -drive.cubic_N_rad3;
    steep_rad = 0.55 * top_rad;
  }
  steps2_N = kSteps * kSteps / std::min(nominal.force_N(std::min(steep_rad, top_rad)), kTabled_N);
  for (std::size_t i = 0; i < slopes.size(); ++i) {
    const double force_N = static_cast<double>(i * i) / steps2_N;
    slopes[i].bounds_N_rad[kLower] = kSlopeLower * slope_from_curve_N_rad(force_N - force_tolerance_N);
    slopes[i].bounds_N_rad[kUpper] =
        kSlopeUpper * slope_from_curve_N_rad(force_N + force_tolerance_N) + kSlopeUnknown_N_rad;
    slopes[i].nominal_N_rad = slope_from_curve_N_rad(force_N);
  }
}

/// Of the nominal brake where it has this force: Newton's method from where a brake without k1 has it. None
/// without force.
double ReadingMonitor::Bounds::slope_from_curve_N_rad(double force_N) const noexcept {
  if (force_N <= 0.0) return 0.0;
  double u = std::sqrt(force_N / nominal.quadratic_N_rad2);
  for (int i = 0; i < 4; ++i) {
    u = std::min(u, steep_rad);
    u -= (nominal.force_N(u) - force_N) / std::max(nominal.slope_N_rad(u), 1.0);
  }
  return nominal.slope_N_rad(std::clamp(u, 0.0, steep_rad));
}

/// From the table; as without force where it is negative.
inline ReadingMonitor::Bounds::Slope ReadingMonitor::Bounds::slope(double force_N) const noexcept {
  const double root = smaller(std::sqrt(larger(force_N, 0.0) * steps2_N), double{kSteps});
  const auto whole = static_cast<std::ptrdiff_t>(root);
  const double share = root - static_cast<double>(whole);
  const Slope* at = slopes.data() + whole;
  return {at[0].bounds_N_rad + share * (at[1].bounds_N_rad - at[0].bounds_N_rad),
          at[0].nominal_N_rad + share * (at[1].nominal_N_rad - at[0].nominal_N_rad)};
}

/// The most that friction may be at a force, which is not negative.
inline DryFriction ReadingMonitor::Bounds::friction(double force_N) const noexcept {
  return {unloaded.coulomb_Nm + kCoulombLoad_Nm_N * force_N,
          unloaded.beyond_coulomb_Nm + load_friction_Nm_N * force_N, unloaded.stribeck_s2_rad2};
}

std::size_t ReadingMonitor::depth_at(double period_s) noexcept {
  constexpr double kLatest_s = 3e-3;
  const auto samples = static_cast<std::size_t>(std::ceil(kLatest_s / period_s - 1e-9));
  // A difference of positions tells the velocity of half a sample ago: its change is that of two torques.
  return std::clamp<std::size_t>(1 + samples, 3, kHistory);
}

void ReadingMonitor::Torques::fill_reported(double torque_Nm) noexcept {
  for (Pair& value_Nm : values_Nm_) value_Nm[kReported] = torque_Nm;
}

inline ReadingMonitor::Pair ReadingMonitor::Torques::least_Nm() const noexcept {
  const auto& [a, b, c, d] = values_Nm_;
  return smaller(smaller(a, b), smaller(c, d));
}

inline ReadingMonitor::Pair ReadingMonitor::Torques::most_Nm() const noexcept {
  const auto& [a, b, c, d] = values_Nm_;
  return larger(larger(a, b), larger(c, d));
}

inline ReadingMonitor::Pair ReadingMonitor::Speeds::outside_rad_s(Pair velocity_rad_s,
                                                                  double change_rad_s) noexcept {
  const auto& [a, b, c, d] = commanded_rad_s_;
  lower_rad_s_ = smaller(smaller(smaller(a, b), smaller(c, d)), lower_rad_s_ + change_rad_s);
  upper_rad_s_ = larger(larger(larger(a, b), larger(c, d)), upper_rad_s_ - change_rad_s);
  return larger(lower_rad_s_ - velocity_rad_s, velocity_rad_s - upper_rad_s_);
}

inline void ReadingMonitor::Forces::push(double force_N) noexcept {
  values_N_[oldest_] = force_N;
  oldest_ = oldest_ + 1 < values_N_.size() ? oldest_ + 1 : 0;
}

/// Of five, so that two outliers beside each other are none. Without branches.
inline double ReadingMonitor::Forces::median_N() const noexcept {
  const auto& [a, b, c, d, e] = values_N_;
  const double lower = larger(smaller(a, b), smaller(c, d));
  const double upper = smaller(larger(a, b), larger(c, d));
  return larger(smaller(lower, upper), smaller(larger(lower, upper), e));
}

void ReadingMonitor::restart() noexcept {
  const Torques torques_Nm = torques_Nm_;
  *this = ReadingMonitor(tolerances_, bounds_);
  torques_Nm_ = torques_Nm;
}

void ReadingMonitor::begin_at(const BrakeFeedback& feedback) noexcept {
  torques_Nm_.fill_reported(feedback.torque_Nm);
  forces_N_.fill(feedback.force_N);
  positions_rad_.fill(feedback.position_rad);
  force_N_ = feedback.force_N;
  momentum_ = {};
  momentum_.before_rad_s += feedback.velocity_rad_s;
  speeds_.begin_at(feedback.velocity_rad_s);
  torque_excess_Nm_ = position_excess_rad_ = unanswered_N_ = 0.0;
  speed_excess_rad_s_ = Pair{};
  force_excess_N_ = Pair{};
  settling_ = kHistory;
  index_ = feedback.sample_index;
  velocity_repeats_.repeats_too_often(feedback.velocity_rad_s, false);
  force_repeats_.repeats_too_often(feedback.force_N, false);
  position_repeats_.repeats_too_often(feedback.position_rad, false);
}

inline double ReadingMonitor::compare_torque(double reading_Nm, double least_Nm, double most_Nm,
                                             double samples) noexcept {
  const double beyond_Nm = larger(least_Nm - reading_Nm, reading_Nm - most_Nm);
  const double largest_Nm = larger(larger(-least_Nm, most_Nm), std::abs(reading_Nm));
  const double excess_Nm = beyond_Nm - tolerances_.torque_Nm - kTorqueShare * largest_Nm;
  torque_excess_Nm_ = larger(torque_excess_Nm_ + larger(excess_Nm, -tolerances_.torque_Nm) * samples, 0.0);
  return torque_excess_Nm_ / (kTorqueSamples * tolerances_.torque_Nm);
}

ReadingMonitor::Pair ReadingMonitor::compare_speed(Pair velocity_rad_s, double elapsed_s) noexcept {
  const double force_N = larger(force_N_, 0.0);
  const double holding_Nm = bounds_.ratio_upper_m_rad * force_N + bounds_.friction(force_N).torque_Nm(0.0);
  const double sure_Nm = larger(kSureTorque * bounds_.most_torque_Nm - holding_Nm,
                                kLeastTorque * bounds_.most_torque_Nm);
  const Pair outside_rad_s =
      speeds_.outside_rad_s(velocity_rad_s, sure_Nm * bounds_.heavy_per_kg_m2 * elapsed_s);
  const Pair tolerance_rad_s = Pair{} + kSpeedTolerance * tolerances_.velocity_rad_s;
  const Pair excess_rad_s =
      outside_rad_s - tolerance_rad_s - kSpeedShare * larger(velocity_rad_s, -velocity_rad_s);
  const double samples = elapsed_s / bounds_.period_s;
  speed_excess_rad_s_ =
      larger(speed_excess_rad_s_ + larger(excess_rad_s, -tolerance_rad_s) * samples, Pair{});
  return speed_excess_rad_s_ / (kSpeedSamples * tolerances_.velocity_rad_s);
}

inline ReadingMonitor::Drivers ReadingMonitor::drivers(double least_Nm, double most_Nm, double elapsed_s,
                                                       bool stop_ahead) const noexcept {
  const double force_N = larger(force_N_, 0.0);
  const double unknown_Nm = kTorqueUnknown_Nm + kTorqueUnknownShare * larger(-least_Nm, most_Nm);
  const double load_lower_Nm = bounds_.ratio_lower_m_rad * larger(force_N - kForceUnknown_N, 0.0);
  const double load_upper_Nm = bounds_.ratio_upper_m_rad * (force_N + kForceUnknown_N);
  return {least_Nm - load_upper_Nm - unknown_Nm, most_Nm - load_lower_Nm + unknown_Nm,
          bounds_.friction(force_N), elapsed_s, stop_ahead};
}

inline ReadingMonitor::Pair ReadingMonitor::compare_momentum(const Drivers& drivers,
                                                             Pair velocity_rad_s) noexcept {
  constexpr Pair kZero{};
  const Pair before_rad_s = momentum_.before_rad_s;
  momentum_.before_rad_s = velocity_rad_s;
  const Pair least_rad_s = smaller(velocity_rad_s, before_rad_s);
  const Pair most_rad_s = larger(velocity_rad_s, before_rad_s);
  const auto forward = least_rad_s > kSurelyMoving_rad_s;
  const auto backward = most_rad_s < -kSurelyMoving_rad_s;

  // The larger of the two speeds, and the smaller one with either sign.
  const Pair faster_rad_s = larger(most_rad_s, -least_rad_s);
  const Pair slower_rad_s = smaller(most_rad_s, -least_rad_s);
  const Pair friction_Nm = drivers.friction.torque_Nm(slower_rad_s) + bounds_.viscous_Nm_s_rad * faster_rad_s;
  const Pair most_Nm = drivers.upper_Nm + (forward ? kZero : friction_Nm);
  const Pair least_Nm = drivers.lower_Nm - (backward ? kZero : friction_Nm);
  const double light = drivers.elapsed_s * bounds_.light_per_kg_m2,
               heavy = drivers.elapsed_s * bounds_.heavy_per_kg_m2;
  const Pair lower_rad_s = smaller(least_Nm * light, least_Nm * heavy);
  const Pair upper_rad_s = larger(most_Nm * light, most_Nm * heavy);

  const Pair change_rad_s = velocity_rad_s - before_rad_s;
  Pair above_rad_s = larger(kForgetSlow * momentum_.above_rad_s + change_rad_s - upper_rad_s, kZero);
  const Pair below_rad_s = larger(kForgetSlow * momentum_.below_rad_s - change_rad_s + lower_rad_s, kZero);
  // The stop holds what opens; it turns nothing round.
  if (drivers.stop_ahead) above_rad_s = velocity_rad_s < kSurelyMoving_rad_s ? kZero : above_rad_s;
  momentum_.above_rad_s = above_rad_s;
  momentum_.below_rad_s = below_rad_s;
  const Pair level = larger(above_rad_s, below_rad_s) / tolerances_.velocity_rad_s;
  momentum_.peak = larger(kForgetSlow * momentum_.peak, level);
  return level;
}

inline double ReadingMonitor::compare_position(double velocity_rad_s, double step_rad,
                                               double elapsed_s) noexcept {
  const double mean_rad_s = 0.5 * (velocity_rad_s + velocity_repeats_.last());
  position_excess_rad_ = kForgetFast * position_excess_rad_ + step_rad - mean_rad_s * elapsed_s;
  const double both_rad_s = smaller(std::abs(mean_rad_s), std::abs(step_rad / elapsed_s));
  common_speed_rad_s_ = larger(kForgetFast * common_speed_rad_s_, both_rad_s);
  return std::abs(position_excess_rad_) /
         (tolerances_.position_rad + bounds_.velocity_lag_s * common_speed_rad_s_);
}

inline double ReadingMonitor::compare_force(double reading_N, double step_rad) noexcept {
  constexpr Pair kZero{};
  const double before_N = force_N_;
  forces_N_.push(reading_N);
  force_N_ = forces_N_.median_N();

  const Bounds::Slope slope = bounds_.slope(before_N);
  const Pair due_N = slope.bounds_N_rad * step_rad;
  const double change_N = force_N_ - before_N;
  const Pair outside_N{change_N - larger(due_N[kLower], due_N[kUpper]),
                       smaller(due_N[kLower], due_N[kUpper]) - change_N};
  force_excess_N_ = larger(kForgetForce * force_excess_N_ + outside_N, kZero);
  const double nominal_N = slope.nominal_N_rad * std::abs(step_rad);
  force_rate_N_ = larger(kForgetFast * force_rate_N_, nominal_N);

  const bool unanswered = reading_N == force_repeats_.last() && before_N > tolerances_.force_N;
  unanswered_N_ = unanswered ? unanswered_N_ + 0.5 * nominal_N : 0.0;

  const double force_N = larger(before_N, 0.0);
  const double tolerance_N =
      tolerances_.force_N + kForceShare * force_N + bounds_.force_lag_samples * force_rate_N_;
  const Pair level = force_excess_N_ / Pair{tolerance_N, tolerance_N + kRelaxation * force_N};
  const double jump_N = std::abs(reading_N - before_N);
  return larger(larger(level[kAbove], level[kBelow]), jump_N / (kForceJump * tolerance_N));
}

inline double ReadingMonitor::compare_compression(double position_rad, double lagging_rad,
                                                  const ReadingContext& context) const noexcept {
  if (!context.contact_known) return 0.0;
  // A force reading that lags is that of an earlier position.
  const Pair range_rad{smaller(position_rad, lagging_rad) - context.contact_rad - kContactUnknown_rad,
                       larger(position_rad, lagging_rad) - context.contact_rad + kContactUnknown_rad};
  const Pair in_contact_rad = larger(smaller(range_rad, Pair{} + bounds_.top_rad), Pair{});
  const Pair bounds_N = Pair{kForceLower, kForceUpper} * bounds_.nominal.force_in_contact_N(in_contact_rad);
  const double force_N = force_N_ - context.force_zero_N;
  return larger(bounds_N[kLower] - force_N, force_N - bounds_N[kUpper]) / tolerances_.force_N;
}

bool ReadingMonitor::encoder_stands_still() const noexcept {
  return position_repeats_.repeats() >= kStill && velocity_repeats_.repeats() >= kStill;
}

/// Which of the two, now that they contradict each other: what contradicts the torque, too, or repeats
/// itself.
FaultCause ReadingMonitor::position_or_velocity() const noexcept {
  if (position_repeats_.repeats() >= kStill) return FaultCause::PositionReading;
  if (velocity_repeats_.repeats() >= kStill) return FaultCause::VelocityReading;
  return momentum_.peak[kDifferentiated] > momentum_.peak[kRead] ? FaultCause::PositionReading
                                                                 : FaultCause::VelocityReading;
}

/// Position and velocity agree, move, and contradict the torque.
FaultCause ReadingMonitor::torque_or_force(const Levels& levels) const noexcept {
  if (levels.force > kHint) return FaultCause::ForceReading;
  // Of a brake that moves as it was told, the torque is what it has to be, whatever its reading says; unless
  // it is not known yet whether the force reading answers.
  const bool follows = levels.speed[kRead] < kHint && levels.speed[kDifferentiated] < kHint;
  if (commanded_ == CommandedQuantity::Velocity && follows && levels.contact_known &&
      levels.compression < kHint)
    return FaultCause::TorqueReading;
  // What resists is a force that the reading does not show.
  const bool resisted = momentum_.below_rad_s[kRead] > momentum_.above_rad_s[kRead];
  return resisted && common_speed_rad_s_ > 1.0 ? FaultCause::ForceReading : FaultCause::TorqueAgainstMotion;
}

/// Of a brake that does not do what it was told, both velocities say so.
FaultCause ReadingMonitor::speed_verdict(const Levels& levels) noexcept {
  if (levels.speed[kDifferentiated] < kHint) return FaultCause::VelocityReading;
  if (levels.speed[kRead] < kHint) return FaultCause::PositionReading;
  return FaultCause::SpeedNotFollowed;
}

FaultCause ReadingMonitor::verdict(const Levels& levels) const noexcept {
  if (levels.torque >= 1.0) return FaultCause::TorqueReading;
  if (levels.position >= 1.0) return position_or_velocity();
  if (levels.by_velocity >= 1.0 || levels.by_position >= 1.0) {
    if (levels.torque > kHint) return FaultCause::TorqueReading;
    if (levels.by_position < kHint * levels.by_velocity) return FaultCause::VelocityReading;
    if (levels.by_velocity < kHint * levels.by_position) return FaultCause::PositionReading;
    if (encoder_stands_still()) return FaultCause::TorqueAgainstMotion;
    if (levels.position > kHint) return position_or_velocity();
    return torque_or_force(levels);
  }
  if (levels.velocity_stuck) return FaultCause::VelocityReading;
  if (levels.force_stuck) return FaultCause::ForceReading;
  if (levels.force >= 1.0 || levels.compression >= 1.0) {
    if (encoder_stands_still()) return FaultCause::TorqueAgainstMotion;
    return levels.position > kHint && momentum_.peak[kDifferentiated] > momentum_.peak[kRead]
               ? FaultCause::PositionReading
               : FaultCause::ForceReading;
  }
  if (levels.speed[kRead] >= 1.0 || levels.speed[kDifferentiated] >= 1.0) return speed_verdict(levels);
  return FaultCause::None;
}

FaultCause ReadingMonitor::observe(const BrakeFeedback& feedback, const ReadingContext& context) noexcept {
  const std::int64_t samples = feedback.sample_index - index_;
  if (samples <= 0 || samples > kBridgedGap) {
    begin_at(feedback);
    return FaultCause::None;
  }
  index_ = feedback.sample_index;
  const double elapsed_s = static_cast<double>(samples) * bounds_.period_s;
  const double step_rad = feedback.position_rad - position_repeats_.last();
  torques_Nm_.push(kReported, feedback.torque_Nm);
  const std::size_t oldest = forces_N_.oldest();
  const double lagging_rad = positions_rad_[(oldest + kForceLag - bounds_.force_lag_rows) % kForceLag];
  positions_rad_[oldest] = feedback.position_rad;
  const double force = compare_force(feedback.force_N, step_rad);
  const double compression = compare_compression(feedback.position_rad, lagging_rad, context);
  const double position = compare_position(feedback.velocity_rad_s, step_rad, elapsed_s);
  const Pair least_Nm = torques_Nm_.least_Nm(), most_Nm = torques_Nm_.most_Nm();
  const Drivers drivers =
      this->drivers(least_Nm[kReported], most_Nm[kReported], elapsed_s, context.stop_ahead);
  const Pair velocity_rad_s{feedback.velocity_rad_s, step_rad / elapsed_s};
  const Pair by_motion = compare_momentum(drivers, velocity_rad_s);
  const bool by_torque = commanded_ == CommandedQuantity::Torque;
  const double torque = by_torque ? compare_torque(feedback.torque_Nm, least_Nm[kCommanded],
                                                   most_Nm[kCommanded], static_cast<double>(samples))
                                  : 0.0;
  const Pair speed = by_torque ? Pair{} : compare_speed(velocity_rad_s, elapsed_s);
  const bool velocity_stuck = velocity_repeats_.repeats_too_often(feedback.velocity_rad_s, context.at_rest);
  const bool force_stuck = force_repeats_.repeats_too_often(feedback.force_N, context.at_rest) ||
                           (unanswered_N_ > kFrozenForce_N && force_repeats_.repeats() >= kFrozenRepeats);
  position_repeats_.repeats_too_often(feedback.position_rad, false);
  if (settling_ > 0) {
    --settling_;
    return FaultCause::None;
  }
  const double largest =
      std::max(std::max(std::max(torque, position), std::max(by_motion[kRead], by_motion[kDifferentiated])),
               std::max(std::max(force, compression), std::max(speed[kRead], speed[kDifferentiated])));
  // Not ">= 1": a level that is no number hides none of the others from the verdict.
  if (largest < 1.0 && !velocity_stuck && !force_stuck) return FaultCause::None;
  return verdict({torque, position, by_motion[kRead], by_motion[kDifferentiated], force, compression, speed,
                  velocity_stuck, force_stuck, context.contact_known});
}

}  // namespace clampd::rt
