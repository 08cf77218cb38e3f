#include "rt/reading_monitor.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/clock.hpp"

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
constexpr double kForceLower = 0.45, kForceUpper = 1.6;
constexpr double kContactUnknown_rad = 1.5;
constexpr double kRelaxation = 0.1;  // share of the force that pads may lose at a standstill

constexpr double kTorqueShare = 0.2;
constexpr double kTorqueSamples = 10.0;       // samples at the tolerance that make a contradiction
constexpr double kVelocityLag_samples = 3.0;  // a velocity reading may be filtered
constexpr double kForceLag_samples = 5.0;
constexpr double kForceShare = 0.03;
constexpr double kForceJump = 3.0;  // tolerances; so much in one sample is wrong at once, not an outlier
constexpr double kFrozenForce_N = 300.0;  // due, while the reading repeated exactly
constexpr int kFrozenRepeats = 3;
constexpr int kStill = 8;  // equal samples in a row of a reading that stands still

constexpr double kForgetFast = 0.967;  // a sample: 30 ms
constexpr double kForgetSlow = 0.99;   // 100 ms
constexpr double kForgetForce = 0.98;  // 50 ms
constexpr int kBridgedGap = 3;         // samples that may be missing

constexpr int kLearnSamples = 50;  // at rest, before noise counts as known
constexpr int kNoisyRow = 8;       // a longer row of equal readings at rest: too little noise to judge by
constexpr int kRepeatFactor = 5, kRepeatMargin = 5;
constexpr int kMaxRepeats = 1'000'000;

/// Of five, so that two outliers beside each other are none. Without branches.
double median_of(const std::array<double, 5>& values) noexcept {
  const auto& [a, b, c, d, e] = values;
  const double lower = std::max(std::min(a, b), std::min(c, d));
  const double upper = std::min(std::max(a, b), std::max(c, d));
  return std::max(std::min(lower, upper), std::min(std::max(lower, upper), e));
}

template <std::size_t n>
void push(std::array<double, n>& history, double value) noexcept {
  std::copy(history.begin() + 1, history.end(), history.begin());
  history.back() = value;
}

}  // namespace

bool RepeatWatch::repeats_too_often(double reading, bool learn) noexcept {
  const bool same = has_last_ && reading == last_;
  repeats_ = same ? std::min(repeats_ + 1, kMaxRepeats) : 0;
  last_ = reading;
  has_last_ = true;
  const bool known = learned_ >= kLearnSamples && longest_ <= kNoisyRow;
  if (known && repeats_ > kRepeatFactor * std::max(longest_, 1) + kRepeatMargin) return true;
  if (learn) {
    learned_ = std::min(learned_ + 1, kMaxRepeats);
    longest_ = std::max(longest_, repeats_);
  }
  return false;
}

void ReadingMonitor::Excess::add(double change, const Interval& bounds, double keep) noexcept {
  above = std::max(0.0, keep * above + change - bounds.upper);
  below = std::max(0.0, keep * below - change + bounds.lower);
}

void ReadingMonitor::restart() noexcept {
  const auto commands_Nm = commands_Nm_;
  *this = ReadingMonitor(tolerances_, drive_);
  commands_Nm_ = commands_Nm;
}

void ReadingMonitor::commanded(double torque_Nm) noexcept {
  push(commands_Nm_, torque_Nm);
}

void ReadingMonitor::begin_at(const BrakeFeedback& feedback) noexcept {
  torques_Nm_.fill(feedback.torque_Nm);
  forces_N_.fill(feedback.force_N);
  force_N_ = feedback.force_N;
  by_velocity_ = {feedback.velocity_rad_s, {}, 0.0, 0.0};
  by_position_ = {feedback.velocity_rad_s, {}, 0.0, 0.0};
  torque_excess_Nm_ = position_excess_rad_ = unanswered_N_ = 0.0;
  force_excess_N_ = {};
  settling_ = kHistory;
  previous_ = feedback;
  has_previous_ = true;
}

ReadingMonitor::Interval ReadingMonitor::torque_range() const noexcept {
  const auto [lowest, highest] = std::minmax_element(torques_Nm_.begin(), torques_Nm_.end());
  return {*lowest, *highest};
}

/// The most that friction may be at this speed and force.
double ReadingMonitor::friction_Nm(double speed_rad_s, double force_N) const noexcept {
  return kDryFriction * drive_.dry_friction_Nm(speed_rad_s / kStribeckWidth, force_N) +
         kCoulombLoad_Nm_N * force_N + kViscousFriction * drive_.viscous_Nm_s_rad * speed_rad_s;
}

/// Of the nominal brake where it has this force.
double ReadingMonitor::slope_N_rad(double force_N) const noexcept {
  if (force_N <= 0.0) return 0.0;
  const StiffnessCurve nominal = drive_.stiffness();
  const double cubic = nominal.cubic_N_rad3, quadratic = nominal.quadratic_N_rad2;
  double u = std::sqrt(force_N / quadratic);
  // A cubic with k1 < 0 turns over at the end; its steepest place is half way, and it is steep enough to
  // there.
  const double end_rad = cubic < 0.0 ? 0.55 * quadratic / -cubic * (2.0 / 3.0) : 1e3;
  for (int i = 0; i < 2; ++i) {
    u = std::min(u, end_rad);
    u -= (nominal.force_N(u) - force_N) / std::max(nominal.slope_N_rad(u), 1.0);
  }
  return nominal.slope_N_rad(std::clamp(u, 0.0, end_rad));
}

double ReadingMonitor::nominal_N(double compression_rad) const noexcept {
  const double quadratic = drive_.quadratic_N_rad2, cubic = drive_.cubic_N_rad3;
  // Beyond the top of the nominal curve nothing is known but that the force is there.
  const double top_rad = cubic < 0.0 ? 2.0 / 3.0 * quadratic / -cubic : compression_rad;
  const double u = std::clamp(compression_rad, 0.0, std::max(0.0, top_rad));
  return drive_.stiffness().force_N(u);
}

void ReadingMonitor::compare_torque(double samples) noexcept {
  const auto [lowest, highest] = std::minmax_element(commands_Nm_.begin(), commands_Nm_.end());
  const double reading_Nm = torques_Nm_.back();
  const double beyond_Nm = std::max({0.0, *lowest - reading_Nm, reading_Nm - *highest});
  const double largest_Nm = std::max({std::abs(*lowest), std::abs(*highest), std::abs(reading_Nm)});
  const double excess_Nm = beyond_Nm - tolerances_.torque_Nm - kTorqueShare * largest_Nm;
  torque_excess_Nm_ =
      std::max(0.0, torque_excess_Nm_ + std::max(excess_Nm, -tolerances_.torque_Nm) * samples);
  torque_level_ = torque_excess_Nm_ / (kTorqueSamples * tolerances_.torque_Nm);
}

ReadingMonitor::Drivers ReadingMonitor::drivers() const noexcept {
  Drivers drivers;
  drivers.force_N = std::max(0.0, force_N_);
  const Interval torque_Nm = torque_range();
  const double unknown_Nm = kTorqueUnknown_Nm + kTorqueUnknownShare * std::max(std::abs(torque_Nm.lower),
                                                                               std::abs(torque_Nm.upper));
  const double load_lower_Nm =
      kRatioLower * drive_.ratio_m_rad * std::max(0.0, drivers.force_N - kForceUnknown_N);
  const double load_upper_Nm = kRatioUpper * drive_.ratio_m_rad * (drivers.force_N + kForceUnknown_N);
  drivers.torque_Nm = {torque_Nm.lower - load_upper_Nm - unknown_Nm,
                       torque_Nm.upper - load_lower_Nm + unknown_Nm};
  return drivers;
}

void ReadingMonitor::compare_momentum(Momentum& momentum, const Drivers& drivers, double velocity_rad_s,
                                      double elapsed_s, bool stop_ahead) noexcept {
  const double before_rad_s = momentum.before_rad_s;
  momentum.before_rad_s = velocity_rad_s;
  const double slower_rad_s = std::min(std::abs(velocity_rad_s), std::abs(before_rad_s));
  const double faster_rad_s = std::max(std::abs(velocity_rad_s), std::abs(before_rad_s));
  const bool forward = std::min(velocity_rad_s, before_rad_s) > kSurelyMoving_rad_s;
  const bool backward = std::max(velocity_rad_s, before_rad_s) < -kSurelyMoving_rad_s;

  const double friction_Nm = this->friction_Nm(slower_rad_s, drivers.force_N) +
                             kViscousFriction * drive_.viscous_Nm_s_rad * (faster_rad_s - slower_rad_s);
  const double most_Nm = drivers.torque_Nm.upper + (forward ? 0.0 : friction_Nm);
  const double least_Nm = drivers.torque_Nm.lower - (backward ? 0.0 : friction_Nm);
  const double light = kInertiaLower * drive_.inertia_kg_m2, heavy = kInertiaUpper * drive_.inertia_kg_m2;
  const Interval change_rad_s{elapsed_s * least_Nm / (least_Nm < 0.0 ? light : heavy),
                              elapsed_s * most_Nm / (most_Nm > 0.0 ? light : heavy)};

  momentum.excess_rad_s.add(velocity_rad_s - before_rad_s, change_rad_s, kForgetSlow);
  // The stop holds what opens; it turns nothing round.
  if (stop_ahead && velocity_rad_s < kSurelyMoving_rad_s) momentum.excess_rad_s.above = 0.0;
  momentum.level = momentum.excess_rad_s.larger() / tolerances_.velocity_rad_s;
  momentum.peak = std::max(kForgetSlow * momentum.peak, momentum.level);
}

void ReadingMonitor::compare_position(const BrakeFeedback& feedback, double step_rad,
                                      double elapsed_s) noexcept {
  const double mean_rad_s = 0.5 * (feedback.velocity_rad_s + previous_.velocity_rad_s);
  position_excess_rad_ = kForgetFast * position_excess_rad_ + step_rad - mean_rad_s * elapsed_s;
  const double both_rad_s = std::min(std::abs(mean_rad_s), std::abs(step_rad / elapsed_s));
  common_speed_rad_s_ = std::max(kForgetFast * common_speed_rad_s_, both_rad_s);
  position_level_ = std::abs(position_excess_rad_) /
                    (tolerances_.position_rad + kVelocityLag_samples * kPeriod_s * common_speed_rad_s_);
}

void ReadingMonitor::compare_force(const BrakeFeedback& feedback, double step_rad) noexcept {
  const double before_N = force_N_;
  push(forces_N_, feedback.force_N);
  force_N_ = median_of(forces_N_);
  const double change_N = force_N_ - before_N;

  const double slope_lower = kSlopeLower * slope_N_rad(before_N - tolerances_.force_N);
  const double slope_upper = kSlopeUpper * slope_N_rad(before_N + tolerances_.force_N) + kSlopeUnknown_N_rad;
  const double slope = slope_N_rad(std::max(before_N, 0.0));
  const double closing_rad = std::max(0.0, step_rad), opening_rad = std::min(0.0, step_rad);
  const Interval bounds_N{slope_lower * closing_rad + slope_upper * opening_rad,
                          slope_upper * closing_rad + slope_lower * opening_rad};
  force_excess_N_.add(change_N, bounds_N, kForgetForce);
  force_rate_N_ = std::max(kForgetFast * force_rate_N_, slope * std::abs(step_rad));

  const double force_N = std::max(0.0, before_N);
  const double tolerance_N = tolerances_.force_N + kForceShare * force_N + kForceLag_samples * force_rate_N_;
  const double jump_N = std::abs(feedback.force_N - before_N);
  force_level_ = std::max({force_excess_N_.above / tolerance_N,
                           force_excess_N_.below / (tolerance_N + kRelaxation * force_N),
                           jump_N / (kForceJump * tolerance_N)});

  const bool same = feedback.force_N == previous_.force_N;
  const bool in_contact = before_N > tolerances_.force_N;
  unanswered_N_ = same && in_contact ? unanswered_N_ + 0.5 * slope * std::abs(step_rad) : 0.0;
}

void ReadingMonitor::compare_compression(const BrakeFeedback& feedback,
                                         const ReadingContext& context) noexcept {
  compression_level_ = 0.0;
  if (!context.contact_known) return;
  const double compression_rad = feedback.position_rad - context.contact_rad;
  const double force_N = force_N_ - context.force_zero_N;
  const double lower_N = kForceLower * nominal_N(compression_rad - kContactUnknown_rad);
  const double upper_N = kForceUpper * nominal_N(compression_rad + kContactUnknown_rad);
  const double tolerance_N = tolerances_.force_N + kForceLag_samples * force_rate_N_;
  compression_level_ = std::max(lower_N - force_N, force_N - upper_N) / tolerance_N;
}

bool ReadingMonitor::encoder_stands_still() const noexcept {
  return position_repeats_.repeats() >= kStill && velocity_repeats_.repeats() >= kStill;
}

/// Which of the two, now that they contradict each other: what contradicts the torque, too, or repeats
/// itself.
FaultCause ReadingMonitor::position_or_velocity() const noexcept {
  if (position_repeats_.repeats() >= kStill) return FaultCause::PositionReading;
  if (velocity_repeats_.repeats() >= kStill) return FaultCause::VelocityReading;
  return by_position_.peak > by_velocity_.peak ? FaultCause::PositionReading : FaultCause::VelocityReading;
}

FaultCause ReadingMonitor::verdict() const noexcept {
  constexpr double kHint = 0.4;  // of a tolerance: no contradiction, but it tells which of two it is
  if (torque_level_ >= 1.0) return FaultCause::TorqueReading;
  if (position_level_ >= 1.0) return position_or_velocity();
  const double by_velocity = by_velocity_.level, by_position = by_position_.level;
  if (by_velocity >= 1.0 || by_position >= 1.0) {
    if (torque_level_ > kHint) return FaultCause::TorqueReading;
    if (by_position < kHint * by_velocity) return FaultCause::VelocityReading;
    if (by_velocity < kHint * by_position) return FaultCause::PositionReading;
    if (encoder_stands_still()) return FaultCause::TorqueAgainstMotion;
    if (position_level_ > kHint) return position_or_velocity();
    // Position and velocity agree and move: what resists is a force that the reading does not show.
    const bool resisted = by_velocity_.excess_rad_s.below > by_velocity_.excess_rad_s.above;
    return force_level_ > kHint || (resisted && common_speed_rad_s_ > 1.0) ? FaultCause::ForceReading
                                                                           : FaultCause::TorqueAgainstMotion;
  }
  if (velocity_stuck_) return FaultCause::VelocityReading;
  const bool frozen_force = unanswered_N_ > kFrozenForce_N && force_repeats_.repeats() >= kFrozenRepeats;
  if (frozen_force || force_stuck_) return FaultCause::ForceReading;
  if (force_level_ >= 1.0 || compression_level_ >= 1.0) {
    if (encoder_stands_still()) return FaultCause::TorqueAgainstMotion;
    return position_level_ > kHint && by_position_.peak > by_velocity_.peak ? FaultCause::PositionReading
                                                                            : FaultCause::ForceReading;
  }
  return FaultCause::None;
}

FaultCause ReadingMonitor::observe(const BrakeFeedback& feedback, const ReadingContext& context) noexcept {
  const std::int64_t samples = has_previous_ ? feedback.sample_index - previous_.sample_index : 0;
  if (samples <= 0 || samples > kBridgedGap) {
    begin_at(feedback);
    return FaultCause::None;
  }
  const double elapsed_s = static_cast<double>(samples) * kPeriod_s;
  const double step_rad = feedback.position_rad - previous_.position_rad;
  push(torques_Nm_, feedback.torque_Nm);
  compare_force(feedback, step_rad);
  compare_compression(feedback, context);
  compare_position(feedback, step_rad, elapsed_s);
  const Drivers drivers = this->drivers();
  compare_momentum(by_velocity_, drivers, feedback.velocity_rad_s, elapsed_s, context.stop_ahead);
  compare_momentum(by_position_, drivers, step_rad / elapsed_s, elapsed_s, context.stop_ahead);
  compare_torque(static_cast<double>(samples));
  velocity_stuck_ = velocity_repeats_.repeats_too_often(feedback.velocity_rad_s, context.at_rest);
  force_stuck_ = force_repeats_.repeats_too_often(feedback.force_N, context.at_rest);
  position_repeats_.repeats_too_often(feedback.position_rad, false);
  previous_ = feedback;
  if (settling_ > 0) {
    --settling_;
    return FaultCause::None;
  }
  return verdict();
}

}  // namespace clampd::rt
