#include "rt/check_sequence.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"

namespace clampd::rt {
namespace {

constexpr double kOpeningSpeed_rad_s = 30.0;
constexpr double kOpeningTorque_Nm = 1.0;  // enough to break a clamped brake loose, gentle to an end stop
// Should the force reading be dead, the approach must not clamp hard: this torque holds some 13 kN.
constexpr double kApproachTorque_Nm = 0.8;
// The approach proves the readings: travel by the encoder against travel by the velocity.
constexpr double kProvenTravel_rad = 0.5;
constexpr double kProvenShare = 0.25;
// From run to run the stiffness that the force reading shows does not change by more.
constexpr double kStiffnessChange = 0.12;
constexpr double kComparedForce_N = 2000.0;
constexpr double kGentleRun = 2.5;  // times that: a soft brake that follows it might not compress so far
constexpr double kStretch_rad = 0.7;     // of opening over which the force is averaged
constexpr double kStretchDrop_N = 60.0;  // the force still falls: pads in contact
constexpr double kOpenMargin_rad = 1.5;  // on from where the force no longer falls
constexpr int kStallSamples = 50;        // still, though driven: at the end stop
// A brake that is told its speed soon presses with all of its torque on what stops it: then sooner.
constexpr int kPressingSamples = 3;
constexpr int kBlockedSamples = 20;  // on a move, where more torque may be due for a moment
constexpr double kReliefSpeed_rad_s = 10.0;  // with which it is then led back until it no longer presses
constexpr int kReliefSamples = 100;
constexpr double kRestTorque_Nm = 0.4;  // less than this is no pressing, but friction and noise
constexpr double kGentleRamp_rad_s2 = 1000.0, kMoveRamp_rad_s2 = 4000.0;
constexpr double kStallTravel_rad = 0.05;
constexpr int kRestSamples = 10;
constexpr double kRestSpeed_rad_s = 1.0;
constexpr double kContactLost = 0.5;  // times contact_force_N
/// Compression between two forces, times the nominal one: of a brake with 0.42 times the nominal stiffness.
constexpr double kSoftestCompression = 1.55;
/// Compression in the approach, times the nominal one: of a brake with 2.5 times the nominal
/// stiffness, or an encoder that tells of half the motion.
constexpr double kStiffestCompression = 0.78;
// For how long that has to be so: spikes beside each other are over by then.
constexpr double kDoubted_s = 0.025;
constexpr int kDoubtedSamples = 6;
constexpr double kLearnFactor = 5.0;  // times contact_force_N: how far the approach goes on
constexpr double kMoveSpeed_rad_s = 220.0;
constexpr double kSafeChange_rad_s = 250.0, kFoundAfter = 5.0;  // periods, until a reading that lies is found
constexpr double kArrived_rad = 0.03, kArrived_rad_s = 10.0;  // the second: as far as that goes in a period
constexpr double kDisplaced_rad = 0.3;  // while settling: go back
constexpr int kMaxGap = 50;             // samples over which a prediction makes sense

}  // namespace

void CheckSequence::start(const CheckPlan* plan) noexcept {
  CLAMPD_ASSERT(plan != nullptr && !plan->reference.rows.empty());
  *this = CheckSequence();
  plan_ = plan;
  enter(Stage::Open);
}

void CheckSequence::abandon() noexcept {
  plan_ = nullptr;
  stage_ = Stage::Done;
  done_ = true;
}

void CheckSequence::enter(Stage stage) noexcept {
  stage_ = stage;
  stage_start_ = index_ + 1;
  still_samples_ = 0;
  last_.context.at_rest = stage == Stage::Tare;
  last_.context.stop_ahead = stage == Stage::Open || stage == Stage::Rest;
}

inline CheckPhase CheckSequence::phase() const noexcept {
  switch (stage_) {
    case Stage::Open:
    case Stage::Rest:
      return plan_->open_only ? CheckPhase::Release : CheckPhase::Return;
    case Stage::Return:
      return CheckPhase::Return;
    case Stage::Tare:
      return CheckPhase::Tare;
    case Stage::Approach:
      return CheckPhase::Approach;
    case Stage::Settle:
      return CheckPhase::Settle;
    case Stage::Trajectory:
      return CheckPhase::Trajectory;
    case Stage::Release:
      return CheckPhase::Release;
    case Stage::Done:
      return CheckPhase::Done;
  }
  return CheckPhase::None;
}

const SequenceOutput& CheckSequence::step(const BrakeFeedback& feedback) noexcept {
  if (plan_ == nullptr || done_) {
    last_ = {};
    last_.phase = CheckPhase::Done;
    return last_;
  }
  // Of numbers that are no readings, the sum is none either.
  const bool finite =
      std::isfinite(feedback.force_N + feedback.velocity_rad_s + feedback.torque_Nm + feedback.position_rad);
  if (started_ && feedback.sample_index == index_) return last_;
  if (!finite || (started_ && feedback.sample_index < index_)) {
    last_.torque_Nm = last_.velocity_rad_s = 0.0;
    last_.fault = finite ? FaultCause::FeedbackFrozen : FaultCause::FeedbackImplausible;
    return last_;
  }

  force_N_ = feedback.force_N - last_.context.force_zero_N;
  const double velocity_rad_s = feedback.velocity_rad_s - velocity_offset_rad_s_;
  if (!started_) {
    started_ = true;
    stage_start_ = feedback.sample_index;
    stretch_.begin_rad = stretch_.moved_rad = feedback.position_rad;
    smooth_force_N_ = force_N_;
    pairs_.fill({force_N_, feedback.position_rad});
    observer_.reset({.position_rad = feedback.position_rad});
  } else {
    // The observer stands at the sample after the last one; a gap is bridged with the torque that acted
    // before it.
    const std::int64_t gap = feedback.sample_index - index_ - 1;
    if (gap > kMaxGap)
      observer_.reset({.position_rad = feedback.position_rad});
    else
      for (std::int64_t i = 0; i < gap; ++i)
        observer_.predict(plan_->drive, is_told_speed() ? torque_Nm_ : last_.torque_Nm, force_N_);
  }
  index_ = feedback.sample_index;
  observer_.correct(feedback.position_rad, velocity_rad_s);
  proof_.velocity_rad += velocity_rad_s * plan_->drive.period_s;
  const ForcePair& pair = median_pair({force_N_, feedback.position_rad});
  smooth_force_N_ += 0.3 * (pair.force_N - smooth_force_N_);
  torque_Nm_ = feedback.torque_Nm;
  smooth_torque_Nm_ += 0.05 * (torque_Nm_ - smooth_torque_Nm_);
  const bool presses = torque_Nm_ <= -kOpeningTorque_Nm &&
                       std::abs(feedback.position_rad - pressing_rad_) < kStallTravel_rad;
  pressing_samples_ = presses ? pressing_samples_ + 1 : 0;
  if (!presses) pressing_rad_ = feedback.position_rad;
  if (last_.context.contact_known)
    stiffness_.learn(pair.position_rad, pair.force_N, observer_.velocity_rad_s());
  observer_.predict(plan_->drive, feedback.torque_Nm, std::max(0.0, force_N_));

  last_.phase = phase();
  last_.repeat = repeat_;
  last_.trajectory = trajectory_;
  last_.trajectory_index = -1;
  last_.force_reference_N = 0.0;
  if (stage_ == Stage::Trajectory) {
    const std::int64_t row = index_ - trajectory_start_;
    if (row < static_cast<std::int64_t>(rows().size())) {
      last_.trajectory_index = static_cast<std::int32_t>(row);
      last_.force_reference_N = rows()[static_cast<std::size_t>(row)].force_N;
      compare_stiffness();
    }
  }
  last_.fault = FaultCause::None;
  const bool bounded_in_time = stage_ != Stage::Trajectory && stage_ != Stage::Done;
  if (bounded_in_time && seconds(samples_in_stage()) > plan_->phase_timeout_s) {
    last_.fault = FaultCause::SequenceTimeout;
    last_.torque_Nm = last_.velocity_rad_s = 0.0;
  } else {
    command(decide(feedback));
  }
  if (last_.fault == FaultCause::None) last_.fault = unproven_;
  return last_;
}

/// Limits last.
inline void CheckSequence::command(double wanted) noexcept {
  const double slope_N_rad =
      last_.context.contact_known
          ? stiffness_.curve().slope_N_rad(observer_.position_rad() - stiffness_.contact_rad())
          : 0.0;
  const ControlLimits limits{.torque_Nm = plan_->torque_limit_Nm};
  if (is_told_speed())
    last_.velocity_rad_s = limited_velocity_rad_s(wanted, limits, plan_->drive, force_N_, slope_N_rad);
  else
    last_.torque_Nm =
        limited_torque_Nm(wanted, limits, plan_->drive, observer_.velocity_rad_s(), force_N_, slope_N_rad);
}

/// Gently: with no more than this torque, or by a gentle ramp.
double CheckSequence::keep_speed(double velocity_rad_s, double force_N, double torque_limit_Nm) noexcept {
  if (is_told_speed())
    return ramped_velocity_rad_s(velocity_rad_s, last_.velocity_rad_s, kGentleRamp_rad_s2, plan_->drive);
  return std::clamp(velocity_torque_Nm(velocity_rad_s, 0.0, plan_->drive, observer_.state(), force_N),
                    -torque_limit_Nm, torque_limit_Nm);
}

double CheckSequence::move_to(double target_rad) noexcept {
  if (is_told_speed()) {
    // Told a speed that is too slow to be missed, it may press on its end stop for long.
    if (pressing_samples_ >= kBlockedSamples) unproven_ = FaultCause::SpeedNotFollowed;
    return ramped_velocity_rad_s(
        move_velocity_rad_s(target_rad, kMoveSpeed_rad_s, plan_->drive, observer_.state()),
        last_.velocity_rad_s, kMoveRamp_rad_s2, plan_->drive);
  }
  // A reading that lies is found some periods later; the brake must not be too fast by then.
  const double most_Nm =
      plan_->drive.inertia_kg_m2 * kSafeChange_rad_s / (kFoundAfter * plan_->drive.period_s);
  return std::clamp(
      move_torque_Nm(target_rad, kMoveSpeed_rad_s, plan_->drive, observer_.state(), std::max(0.0, force_N_)),
      -most_Nm, most_Nm);
}

// Of the last three: a single spike is never taken for contact, nor learned.
inline const CheckSequence::ForcePair& CheckSequence::median_pair(const ForcePair& newest) noexcept {
  pairs_ = {pairs_[1], pairs_[2], newest};
  const auto between = [this](std::size_t i, std::size_t a, std::size_t b) {
    return std::min(pairs_[a].force_N, pairs_[b].force_N) <= pairs_[i].force_N &&
           pairs_[i].force_N <= std::max(pairs_[a].force_N, pairs_[b].force_N);
  };
  return between(1, 0, 2) ? pairs_[1] : between(2, 0, 1) ? pairs_[2] : pairs_[0];
}

/// Adds to what this run's force is, as a share of what the nominal brake would have at the same compression.
inline void CheckSequence::compare_stiffness() noexcept {
  run_reference_N_ = std::max(run_reference_N_, last_.force_reference_N);
  const double u = observer_.position_rad() - last_.context.contact_rad;
  if (u <= 0.0) return;
  const double nominal_N = plan_->drive.stiffness().force_N(u);
  if (nominal_N < kComparedForce_N) return;
  run_force_N_ += force_N_;
  run_nominal_N_ += nominal_N;
}

/// At the end of a run: a force reading that was true in the first runs shows the same stiffness in all
/// others that clamp hard enough to compare it.
void CheckSequence::judge_stiffness() noexcept {
  const double share = run_nominal_N_ > 0.0 ? run_force_N_ / run_nominal_N_ : 0.0;
  const bool is_gentle = run_reference_N_ < kGentleRun * kComparedForce_N;
  run_force_N_ = run_nominal_N_ = run_reference_N_ = 0.0;
  if (share <= 0.0 && (first_share_ <= 0.0 || is_gentle)) return;
  if (first_share_ <= 0.0)
    first_share_ = share;
  else if (std::abs(share - first_share_) > kStiffnessChange * first_share_)
    unproven_ = FaultCause::ForceReading;
}

inline const std::vector<ReferenceRow>& CheckSequence::rows() const noexcept {
  return trajectory_ == 0 ? plan_->reference.rows : plan_->further[trajectory_ - 1].rows;
}

/// On the way to a run that is not needed any more.
inline bool CheckSequence::is_concluded_between_runs() const noexcept {
  return concluded_ && repeat_ > 0 && (stage_ == Stage::Return || stage_ == Stage::Settle);
}

inline double CheckSequence::decide(const BrakeFeedback& feedback) noexcept {
  if (is_concluded_between_runs()) {
    --repeat_;  // the last run that there was
    enter(Stage::Release);
  }
  switch (stage_) {
    case Stage::Open:
      return open();
    case Stage::Rest:
      return rest();
    case Stage::Tare:
      return tare(feedback);
    case Stage::Approach:
      return approach();
    case Stage::Return:
      return move_to_start();
    case Stage::Settle:
      return settle();
    case Stage::Trajectory:
      return track();
    case Stage::Release:
      return release();
    case Stage::Done:
      done_ = true;
      return 0.0;
  }
  return 0.0;
}

// Opens until the force no longer falls along the way. The tare is not known yet, so only differences count.
double CheckSequence::open() noexcept {
  const double force_N = std::max(0.0, smooth_force_N_);
  ++still_samples_;
  if (std::abs(observer_.position_rad() - stretch_.moved_rad) > kStallTravel_rad) {
    stretch_.moved_rad = observer_.position_rad();
    still_samples_ = 0;
  }
  stretch_.sum_N += force_N_;
  ++stretch_.samples;
  const double travelled_rad = stretch_.begin_rad - observer_.position_rad();
  if (stretch_.flat < 2) {
    if (travelled_rad >= kStretch_rad) {
      const double mean_N = stretch_.sum_N / stretch_.samples;
      const bool falls = stretch_.has_before && stretch_.before_N - mean_N > kStretchDrop_N;
      stretch_.flat = stretch_.has_before && !falls ? stretch_.flat + 1 : 0;
      stretch_.fell = stretch_.fell || falls;
      stretch_.before_N = mean_N;
      stretch_.has_before = true;
      stretch_.sum_N = 0.0;
      stretch_.samples = 0;
      stretch_.begin_rad = observer_.position_rad();
    }
  } else if (travelled_rad >= (plan_->open_only && stretch_.fell ? plan_->clearance_rad : kOpenMargin_rad)) {
    enter(Stage::Rest);
  }
  const bool stalled =
      is_told_speed() ? pressing_samples_ >= kPressingSamples : still_samples_ >= kStallSamples;
  if (stalled && force_N < plan_->contact_force_N * kLearnFactor) enter(Stage::Rest);
  return keep_speed(-kOpeningSpeed_rad_s, force_N, kOpeningTorque_Nm);
}

double CheckSequence::rest() noexcept {
  // The loop of a brake that was stopped by its end stop may press on it for ever.
  const bool pressing = is_told_speed() && smooth_torque_Nm_ < -kRestTorque_Nm;
  if (pressing && samples_in_stage() < kReliefSamples) {
    still_samples_ = 0;
    return kReliefSpeed_rad_s;
  }
  still_samples_ = std::abs(observer_.velocity_rad_s()) < kRestSpeed_rad_s ? still_samples_ + 1 : 0;
  if (still_samples_ >= kRestSamples) {
    sum_force_N_ = sum_velocity_rad_s_ = 0.0;
    tare_samples_ = 0;
    enter(plan_->open_only ? Stage::Done : Stage::Tare);
  }
  if (still_samples_ > 0 || is_told_speed()) return 0.0;
  return velocity_torque_Nm(0.0, 0.0, plan_->drive, observer_.state(), 0.0);
}

double CheckSequence::tare(const BrakeFeedback& feedback) noexcept {
  sum_force_N_ += feedback.force_N;
  sum_velocity_rad_s_ += feedback.velocity_rad_s;
  ++tare_samples_;
  if (seconds(samples_in_stage() + 1) < plan_->tare_s) return 0.0;
  last_.context.force_zero_N = sum_force_N_ / tare_samples_;
  velocity_offset_rad_s_ = sum_velocity_rad_s_ / tare_samples_;
  smooth_force_N_ = 0.0;
  pairs_.fill({0.0, feedback.position_rad});
  observer_.reset({.position_rad = feedback.position_rad});
  proof_ = {.begin_rad = feedback.position_rad};
  enter(Stage::Approach);
  return 0.0;
}

/// Travel by the encoder and by the velocity since the approach began, or the reading that it disproves.
/// Where they differ, the pads tell: between two forces lies a known compression. Where they agree, and the
/// pads give way more than those of any brake of this product, the force reads too little: the controller
/// would clamp until it reads enough. Where they give way less than any (is_too_stiff()), it reads too much,
/// or the encoder too little.
FaultCause CheckSequence::prove_motion() const noexcept {
  const double position_rad = observer_.position_rad() - proof_.begin_rad;
  const double difference_rad = std::abs(proof_.velocity_rad - position_rad);
  const double larger_rad = std::max(std::abs(proof_.velocity_rad), std::abs(position_rad));
  const double contact_N = plan_->contact_force_N;
  const double expected_rad = std::sqrt(kLearnFactor * contact_N / plan_->drive.quadratic_N_rad2) -
                              std::sqrt(contact_N / plan_->drive.quadratic_N_rad2);
  const double compressed_rad = observer_.position_rad() - proof_.contact_rad;
  if (difference_rad < kProvenTravel_rad + kProvenShare * larger_rad)
    return compressed_rad > kSoftestCompression * expected_rad || is_too_stiff() ? FaultCause::ForceReading
                                                                                  : FaultCause::None;
  return std::abs(compressed_rad - expected_rad) > kProvenShare * expected_rad ? FaultCause::PositionReading
                                                                               : FaultCause::VelocityReading;
}

/// From where the nominal brake's pads would begin to touch by the force with which contact was found: that
/// may have been late.
bool CheckSequence::is_too_stiff() const noexcept {
  // Readings of a millisecond tell by the torque that an encoder reads too little, long before.
  if (plan_->drive.period_s <= kPeriod_s) return false;
  const double quadratic_N_rad2 = plan_->drive.quadratic_N_rad2;
  const double touched_rad = proof_.contact_rad - std::sqrt(proof_.contact_N / quadratic_N_rad2);
  const double expected_rad = std::sqrt(smooth_force_N_ / quadratic_N_rad2);
  return observer_.position_rad() - touched_rad < kStiffestCompression * expected_rad;
}

double CheckSequence::approach() noexcept {
  // Pads that are pressed push back ever more. A force that is gone again was that of spikes beside each
  // other.
  if (smooth_force_N_ < kContactLost * plan_->contact_force_N) last_.context.contact_known = false;
  if (!last_.context.contact_known && smooth_force_N_ > plan_->contact_force_N) {
    stiffness_.start(plan_->drive, observer_.position_rad(), smooth_force_N_);
    proof_.contact_rad = observer_.position_rad();
    proof_.contact_N = smooth_force_N_;
    last_.context.contact_known = true;
    last_.context.contact_rad = stiffness_.contact_rad();
  }
  const bool pressed =
      last_.context.contact_known && smooth_force_N_ > kLearnFactor * plan_->contact_force_N;
  pressed_samples_ = pressed ? pressed_samples_ + 1 : 0;
  // Too soon for any brake may be spikes beside each other, too.
  const bool is_sure = pressed_samples_ >= kDoubtedSamples && seconds(pressed_samples_) >= kDoubted_s;
  if (pressed && (is_sure || !is_too_stiff())) {
    unproven_ = prove_motion();
    enter(Stage::Return);
    return move_to_start();
  }
  // More only where the force that is looked for takes more.
  const double wanted_N = kLearnFactor * plan_->contact_force_N;
  const double holding_Nm =
      plan_->drive.ratio_m_rad * wanted_N + 2.0 * plan_->drive.dry_friction_Nm(0.0, wanted_N);
  const double limit_Nm = std::max(kApproachTorque_Nm, 1.5 * holding_Nm);
  // It presses on what the force reading does not show.
  if (is_told_speed() && smooth_torque_Nm_ > limit_Nm) unproven_ = FaultCause::ForceReading;
  return keep_speed(plan_->approach_velocity_rad_s, std::max(0.0, smooth_force_N_), limit_Nm);
}

double CheckSequence::start_position_rad() const noexcept {
  return stiffness_.contact_rad() + rows().front().position_rad;
}

/// Near enough. Of a slow loop, the last bit of a move asks for less torque than friction holds.
bool CheckSequence::has_arrived_at(double target_rad) const noexcept {
  return std::abs(observer_.position_rad() - target_rad) <
             std::max(kArrived_rad, kArrived_rad_s * plan_->drive.period_s) &&
         std::abs(observer_.velocity_rad_s()) < kRestSpeed_rad_s;
}

double CheckSequence::move_to_start() noexcept {
  if (has_arrived_at(start_position_rad())) {
    enter(Stage::Settle);
    return 0.0;
  }
  return move_to(start_position_rad());
}

double CheckSequence::settle() noexcept {
  // The brake holds itself here: any torque would only disturb the run's initial state.
  if (std::abs(observer_.position_rad() - start_position_rad()) > kDisplaced_rad) {
    enter(Stage::Return);
    return move_to_start();
  }
  if (seconds(samples_in_stage() + 1) < plan_->settle_s) return 0.0;
  enter(Stage::Trajectory);
  trajectory_start_ = index_ + 1;
  return track();
}

inline double CheckSequence::track() noexcept {
  const auto next = static_cast<std::size_t>(index_ + 1 - trajectory_start_);  // the row this command acts in
  if (next >= rows().size()) {
    judge_stiffness();
    ++repeat_;
    const bool again = repeat_ < plan_->repeats && !concluded_;
    if (again) trajectory_ = next_trajectory_ <= plan_->further.size() ? next_trajectory_ : 0;
    if (!again) --repeat_;
    enter(again ? Stage::Return : Stage::Release);
    return again ? move_to_start() : release();
  }
  const ReferenceRow &row = rows()[next], &after = rows()[std::min(next + 1, rows().size() - 1)];
  return is_told_speed() ? tracking_velocity_rad_s(row, after, plan_->drive, observer_, stiffness_)
                         : tracking_torque_Nm(row, after, plan_->drive, observer_, stiffness_);
}

double CheckSequence::release() noexcept {
  // Pads that are pressed are far from the open end stop.
  last_.context.stop_ahead = smooth_force_N_ < kLearnFactor * plan_->contact_force_N;
  const double target_rad = stiffness_.contact_rad() - plan_->clearance_rad;
  if (has_arrived_at(target_rad)) {
    enter(Stage::Done);
    return 0.0;
  }
  return move_to(target_rad);
}

}  // namespace clampd::rt
