#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "clampd/base/realtime.hpp"
#include "clampd/control/control_law.hpp"
#include "clampd/control/motion_observer.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/control/stiffness_estimate.hpp"
#include "clampd/ports/brake_port.hpp"
#include "clampd/record/reference.hpp"
#include "clampd/record/sample.hpp"
#include "rt/reading_monitor.hpp"

namespace clampd::rt {

/// One check, planned before it starts and read-only for the loop while it runs.
struct CheckPlan {
  Reference reference;
  /// Other trajectories that a run after the first may follow, each with as many rows; trajectory k of a
  /// check is `reference` for k = 0, else further[k - 1].
  std::vector<Reference> further;
  NominalDrive drive;
  CommandedQuantity commanded = CommandedQuantity::Torque;  ///< what this brake is told
  std::uint16_t repeats = 20;
  double tare_s = 0.5;  ///< rest in the clearance for the offsets
  double approach_velocity_rad_s = 20.0;
  double contact_force_N = 300.0;  ///< contact is found when the tared force passes this; the pads are then
                                   ///< closed to five times as much, to learn where exactly they touch
  double clearance_rad = 6.0;      ///< how far to open from contact at the end, and for the tare
  double settle_s = 0.05;          ///< rest at the contact point before each run
  double phase_timeout_s = 5.0;    ///< any phase but the trajectory: then SequenceTimeout
  double torque_limit_Nm = 3.0;
  double deadline_s = 60.0;  ///< from when the loop takes it: then DeadlinePassed
  /// Open a brake that may be clamped, and no more: no tare, no run. Reports Release throughout.
  bool open_only = false;
};

/// What the loop shall do with this sample.
struct SequenceOutput {
  double torque_Nm = 0.0;  ///< command that acts from the next sample on; already within the plan's limit
  double velocity_rad_s = 0.0;  ///< in its place to a brake that is told its speed
  CheckPhase phase = CheckPhase::None;
  std::uint16_t repeat = 0;
  std::uint8_t trajectory = 0;         ///< which one the run follows
  std::int32_t trajectory_index = -1;  ///< row of the run that *this* sample is; -1 outside of a run
  double force_reference_N = 0.0;      ///< reference at this sample
  ReadingContext context;              ///< what is known of the brake, to judge the next sample by
  FaultCause fault = FaultCause::None;
};

/// The whole check as a state machine over samples: open, tare, approach to contact, n times (settle,
/// trajectory, return), release. Pure: time is the brake's sample clock, no I/O, so that the bench and the
/// tests run the same code.
///
/// Everything counts in samples of the brake, never in ticks: a sample that comes twice is answered twice
/// alike, a gap moves the trajectory on by as many rows. A sample index that runs backwards is
/// FeedbackFrozen.
///
/// The gentle moves before the first run prove the readings: opening and approach are short of torque, the
/// approach ends only with a live force, and by then encoder and velocity must tell of the same travel. The
/// torque of a brake that is told its speed is its own: these moves begin by a ramp, and end where the torque
/// reading shows that it presses.
///
/// A brake that is found clamped, or not open for sure, is opened first; that phase reports Return. A plan
/// that is `open_only` ends there, with the clearance open.
class CheckSequence {
 public:
  /// `plan` must stay alive and unchanged until done() or abandon(); its reference must not be empty.
  CLAMPD_REALTIME void start(const CheckPlan* plan) noexcept;
  /// What it returns holds until the next step.
  CLAMPD_REALTIME const SequenceOutput& step(const BrakeFeedback& feedback) noexcept;
  /// The runs so far are enough: a run that is under way is ended, another does not begin, the brake is
  /// released. Before the first run is over it means nothing.
  CLAMPD_REALTIME void conclude() noexcept { concluded_ = true; }
  /// The trajectory that runs which have not begun their way to it shall follow; the first run always follows
  /// the plan's reference. One that the plan does not have counts as that.
  CLAMPD_REALTIME void follow(std::uint8_t trajectory) noexcept { next_trajectory_ = trajectory; }
  CLAMPD_REALTIME void abandon() noexcept;
  CLAMPD_REALTIME bool done() const noexcept { return done_; }

 private:
  enum class Stage : std::uint8_t { Open, Rest, Tare, Approach, Return, Settle, Trajectory, Release, Done };

  struct ForcePair {
    double force_N = 0.0;  ///< tared
    double position_rad = 0.0;
  };

  CLAMPD_REALTIME const ForcePair& median_pair(const ForcePair& newest) noexcept;
  CLAMPD_REALTIME void compare_stiffness() noexcept;
  CLAMPD_REALTIME void judge_stiffness() noexcept;
  CLAMPD_REALTIME bool is_told_speed() const noexcept {
    return plan_->commanded == CommandedQuantity::Velocity;
  }
  CLAMPD_REALTIME void command(double wanted) noexcept;
  CLAMPD_REALTIME double keep_speed(double velocity_rad_s, double force_N, double torque_limit_Nm) noexcept;
  CLAMPD_REALTIME double move_to(double target_rad) noexcept;
  // What the stages return is a torque, or to a brake that is told its speed, a speed.
  CLAMPD_REALTIME double decide(const BrakeFeedback& feedback) noexcept;
  CLAMPD_REALTIME double open() noexcept;
  CLAMPD_REALTIME double rest() noexcept;
  CLAMPD_REALTIME double tare(const BrakeFeedback& feedback) noexcept;
  CLAMPD_REALTIME FaultCause prove_motion() const noexcept;
  CLAMPD_REALTIME bool is_too_stiff() const noexcept;
  CLAMPD_REALTIME double approach() noexcept;
  CLAMPD_REALTIME bool has_arrived_at(double target_rad) const noexcept;
  CLAMPD_REALTIME double move_to_start() noexcept;
  CLAMPD_REALTIME double settle() noexcept;
  CLAMPD_REALTIME double track() noexcept;
  CLAMPD_REALTIME double release() noexcept;
  CLAMPD_REALTIME bool is_concluded_between_runs() const noexcept;
  CLAMPD_REALTIME void enter(Stage stage) noexcept;
  CLAMPD_REALTIME CheckPhase phase() const noexcept;
  CLAMPD_REALTIME std::int64_t samples_in_stage() const noexcept { return index_ - stage_start_; }
  CLAMPD_REALTIME double seconds(std::int64_t samples) const noexcept {
    return static_cast<double>(samples) * plan_->drive.period_s;
  }
  CLAMPD_REALTIME double start_position_rad() const noexcept;
  CLAMPD_REALTIME const std::vector<ReferenceRow>& rows() const noexcept;

  const CheckPlan* plan_ = nullptr;
  Stage stage_ = Stage::Done;
  bool done_ = false;
  bool started_ = false;  ///< a sample was seen since start()
  bool concluded_ = false;
  std::int64_t index_ = 0;
  std::int64_t stage_start_ = 0;
  std::int64_t trajectory_start_ = 0;
  std::uint16_t repeat_ = 0;
  std::uint8_t trajectory_ = 0;
  std::uint8_t next_trajectory_ = 0;
  SequenceOutput last_;

  double force_N_ = 0.0;  ///< tared reading
  double velocity_offset_rad_s_ = 0.0;
  double smooth_force_N_ = 0.0;
  double torque_Nm_ = 0.0;         ///< reading
  double smooth_torque_Nm_ = 0.0;
  std::array<ForcePair, 3> pairs_{};  ///< the last three, oldest first

  /// Mean force over the last stretches of opening.
  struct Stretch {
    double begin_rad = 0.0;
    double moved_rad = 0.0;  ///< where it was when it last was seen moving
    double sum_N = 0.0;
    int samples = 0;
    double before_N = 0.0;  ///< mean of the stretch before
    bool has_before = false;
    int flat = 0;       ///< stretches without a drop, in a row
    bool fell = false;  ///< it was clamped
  } stretch_;
  int still_samples_ = 0;
  int pressed_samples_ = 0;   ///< of the approach, in a row, with the force that ends it
  int pressing_samples_ = 0;  ///< at a place, with more torque than opening may take
  double pressing_rad_ = 0.0;

  double sum_force_N_ = 0.0;
  double sum_velocity_rad_s_ = 0.0;
  int tare_samples_ = 0;

  /// What the approach proves of the readings.
  struct Proof {
    double begin_rad = 0.0;     ///< encoder, where the approach began
    double velocity_rad = 0.0;  ///< travel since, by the velocity
    double contact_rad = 0.0;   ///< encoder, where contact was found
    double contact_N = 0.0;     ///< the force there
  } proof_;
  double run_force_N_ = 0.0;  ///< sums over the present run
  double run_nominal_N_ = 0.0;
  double run_reference_N_ = 0.0;  ///< the hardest that it is to clamp
  double first_share_ = 0.0;  ///< force over the nominal brake's at the same compression, in the first run
  FaultCause unproven_ = FaultCause::None;

  MotionObserver observer_;
  StiffnessEstimate stiffness_;
};

}  // namespace clampd::rt
