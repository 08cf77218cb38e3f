#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "clampd/base/result.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/ports/brake_port.hpp"
#include "clampd/record/sample.hpp"

namespace clampd::rt {

/// How far readings may contradict each other before one of them is taken for wrong. The defaults leave room
/// for brakes wider than the paper's Table II, for the noisiest sensors that are supported, for sensors that
/// lag by some milliseconds, and for the effects that a diagnosis can name at sizes that it meets in
/// practice.
struct ReadingTolerances {
  double torque_Nm = 0.1;        ///< torque reading against the command, beside a fifth of either
  double velocity_rad_s = 25.0;  ///< change of speed beyond what torque, load and friction can explain; and
                                 ///< so much for 10 ms beside a commanded speed
  double position_rad = 0.3;     ///< position against the integral of the velocity, beside 3 ms of motion
  double force_N = 2500.0;       ///< force against compression, beside 5 ms of motion and a few percent

  /// Error: a tolerance that is not positive and finite; the message names it.
  Result<void> validate() const;
};

/// Whether the reading of a sensor with noise has stopped changing. How often a healthy one repeats itself is
/// learned at rest; a sensor without noise may repeat itself for ever, and is judged by other means.
class RepeatWatch {
 public:
  /// `period_s`: from reading to reading. Of slow ones fewer are waited for: the brake moves on meanwhile.
  explicit RepeatWatch(double period_s = kPeriod_s) noexcept : is_slow_(period_s > kSlow_s) {}

  /// `learn`: the brake is at rest and the reading believed. True: the reading stands still though its
  /// sensor's noise should move it.
  CLAMPD_REALTIME bool repeats_too_often(double reading, bool learn) noexcept {
    repeats_ = reading == last_ ? std::min(repeats_ + 1, kMax) : 0;
    last_ = reading;
    if (repeats_ > tolerated_) return true;
    if (learn) this->learn();
    return false;
  }
  /// How many samples before this one read exactly the same.
  CLAMPD_REALTIME int repeats() const noexcept { return repeats_; }
  /// The last reading; before the first one no number.
  CLAMPD_REALTIME double last() const noexcept { return last_; }

 private:
  static constexpr int kMax = 1'000'000;
  static constexpr double kSlow_s = 3e-3;

  CLAMPD_REALTIME void learn() noexcept;

  double last_ = std::numeric_limits<double>::quiet_NaN();  ///< equals no reading
  int repeats_ = 0;
  int tolerated_ = kMax;  ///< any number, until the noise is known
  int learned_ = 0;       ///< samples at rest
  int longest_ = 0;       ///< row of equal readings at rest
  bool is_slow_;
};

/// What a check knows about the brake on the bench.
struct ReadingContext {
  bool at_rest = false;        ///< the brake is known to rest unloaded: noise can be learned
  bool stop_ahead = false;     ///< it opens and may be held by its open end stop
  bool contact_known = false;  ///< and with it the next two
  double contact_rad = 0.0;    ///< encoder, where the pads begin to touch
  double force_zero_N = 0.0;   ///< force reading without force
};

/// Compares the readings of a driven brake with each other and with the torque that was commanded, and names
/// the one that cannot be true. Bounds, not a model of this very brake: friction, stiffness and inertia may
/// be anything that a brake of this product can have.
///
///   torque against command      the drive does within three commands what it was told
///   velocity against command    in its place where the brake is told its speed: it takes it up as fast as a
///                               part of the torque limit allows
///   velocity against torque     J v' = T - N F - Tf(F, v), with intervals for J, N, Tf; the same for the
///   velocity that
///                               the position's differences give
///   position against velocity   dx = v dt
///   force against position      dF within bounds of F'(x) dx; F within bounds of F(x) once contact is known
///   standing still              a reading that repeats exactly while the brake moves, or while noise should
///   move it
///
/// Each comparison accumulates what its bounds do not explain and forgets it slowly (CUSUM with a leak), so
/// that one odd sample is no fault, but a contradiction is found within milliseconds. A contradiction between
/// two readings is decided by the comparisons that involve only one of them.
class ReadingMonitor {
 public:
  /// Samples by which a force reading may lag, at most.
  static constexpr std::size_t kForceLag = 5;

  /// `torque_limit_Nm`: of the brake's drive.
  ReadingMonitor(const ReadingTolerances& tolerances, const NominalDrive& drive,
                 double torque_limit_Nm) noexcept
      : ReadingMonitor(tolerances, Bounds(drive, tolerances.force_N, torque_limit_Nm)) {}

  /// Forgets everything but the torques that were commanded: a check begins, at rest.
  CLAMPD_REALTIME void restart() noexcept;
  /// What was sent in a tick.
  CLAMPD_REALTIME void commanded(const DriveCommand& command) noexcept {
    commanded_ = command.commanded;
    torques_Nm_.push(kCommanded, command.torque_Nm);
    if (commanded_ == CommandedQuantity::Velocity) speeds_.push(command.velocity_rad_s);
  }

  /// The next sample. None, or the cause that names the reading.
  CLAMPD_REALTIME FaultCause observe(const BrakeFeedback& feedback, const ReadingContext& context) noexcept;

 private:
  /// Two numbers that take the same way, which costs as much as one.
  using Pair = double __attribute__((vector_size(16)));
  static constexpr int kCommanded = 0, kReported = 1;   ///< torques
  static constexpr int kRead = 0, kDifferentiated = 1;  ///< velocities: from the position's differences
  static constexpr int kLower = 0, kUpper = 1;          ///< bounds
  static constexpr int kAbove = 0, kBelow = 1;          ///< what lies outside of them

  /// What a brake of this product may be, from the nominal one.
  struct Bounds {
    /// By how much the force changes with the position.
    struct Slope {
      Pair bounds_N_rad{};
      double nominal_N_rad = 0.0;
    };

    /// `force_tolerance_N`: how far the force at which a slope is looked up may be wrong.
    Bounds(const NominalDrive& drive, double force_tolerance_N, double torque_limit_Nm) noexcept;
    Slope slope(double force_N) const noexcept;
    double slope_from_curve_N_rad(double force_N) const noexcept;
    DryFriction friction(double force_N) const noexcept;

    StiffnessCurve nominal;
    double ratio_lower_m_rad = 0.0, ratio_upper_m_rad = 0.0;
    DryFriction unloaded;  ///< the most friction without force
    double load_friction_Nm_N = 0.0, viscous_Nm_s_rad = 0.0;
    double light_per_kg_m2 = 0.0, heavy_per_kg_m2 = 0.0;  ///< one over the least and the largest inertia
    double most_torque_Nm = 0.0;  ///< of the drive
    double period_s = 0.0;
    double velocity_lag_s = 0.0, force_lag_samples = 0.0;  ///< that readings may have
    std::size_t force_lag_rows = 0;                        ///< the second, of whole samples
    double steep_rad = 0.0;  ///< compression to where the nominal stiffness is steep
    double top_rad = 0.0;    ///< compression of the largest force on the nominal curve
    /// At equal steps of the root of the force, over which the stiffness is nearly straight; the last step
    /// leads on.
    static constexpr int kSteps = 64;
    std::array<Slope, kSteps + 2> slopes{};
    double steps2_N = 0.0;  ///< the square of a force's root in steps, over the force
  };

  static constexpr std::size_t kHistory = 4;
  /// How much of the history counts: the present, and what of it lies within three milliseconds.
  static std::size_t depth_at(double period_s) noexcept;

  /// The last torques that were commanded and reported, in no order.
  class Torques {
   public:
    explicit Torques(std::size_t depth) noexcept : depth_(depth) {}
    /// `which`: kCommanded or kReported, which come at their own times.
    void push(int which, double torque_Nm) noexcept {
      std::size_t& oldest = oldest_[static_cast<std::size_t>(which)];
      values_Nm_[oldest][which] = torque_Nm;
      for (std::size_t unused = depth_; unused < kHistory; ++unused) values_Nm_[unused][which] = torque_Nm;
      oldest = oldest + 1 < depth_ ? oldest + 1 : 0;
    }
    void fill_reported(double torque_Nm) noexcept;
    Pair least_Nm() const noexcept;
    Pair most_Nm() const noexcept;

   private:
    std::array<Pair, kHistory> values_Nm_{};
    std::array<std::size_t, 2> oldest_{};
    std::size_t depth_;
  };

  /// The last force readings, in no order.
  class Forces {
   public:
    void push(double force_N) noexcept;
    void fill(double force_N) noexcept { values_N_.fill(force_N); }
    double median_N() const noexcept;
    std::size_t oldest() const noexcept { return oldest_; }

   private:
    std::array<double, kForceLag> values_N_{};
    std::size_t oldest_ = 0;
  };

  /// Where the speed of a brake may be that does what it was told.
  class Speeds {
   public:
    void push(double commanded_rad_s) noexcept {
      commanded_rad_s_[oldest_] = commanded_rad_s;
      oldest_ = (oldest_ + 1) % kHistory;
    }
    void begin_at(double velocity_rad_s) noexcept { lower_rad_s_ = upper_rad_s_ = velocity_rad_s; }
    /// By how much both velocities lie outside, once the brake has had time for this change of them. Not
    /// positive within.
    Pair outside_rad_s(Pair velocity_rad_s, double change_rad_s) noexcept;

   private:
    std::array<double, kHistory> commanded_rad_s_{};  ///< the last ones, in no order
    std::size_t oldest_ = 0;
    double lower_rad_s_ = 0.0, upper_rad_s_ = 0.0;
  };

  /// Both velocities against the torque.
  struct Momentum {
    Pair before_rad_s{};
    Pair above_rad_s{}, below_rad_s{};  ///< how far changes lay outside of their bounds, accumulated
    Pair peak{};                        ///< of their levels, forgotten slowly
  };

  /// What moves the motor in one sample.
  struct Drivers {
    double lower_Nm = 0.0, upper_Nm = 0.0;  ///< the drive less the load of the force
    DryFriction friction;                   ///< the most it may be
    double elapsed_s = 0.0;
    bool stop_ahead = false;
  };

  /// How large each contradiction is, as a share of what is tolerated; 1 is one.
  struct Levels {
    double torque = 0.0, position = 0.0, by_velocity = 0.0, by_position = 0.0, force = 0.0, compression = 0.0;
    Pair speed{};
    bool velocity_stuck = false, force_stuck = false, contact_known = false;
  };

  ReadingMonitor(const ReadingTolerances& tolerances, const Bounds& bounds) noexcept
      : tolerances_(tolerances), bounds_(bounds) {}
  void begin_at(const BrakeFeedback& feedback) noexcept;
  double compare_torque(double reading_Nm, double least_Nm, double most_Nm, double samples) noexcept;
  Pair compare_speed(Pair velocity_rad_s, double elapsed_s) noexcept;
  Drivers drivers(double least_Nm, double most_Nm, double elapsed_s, bool stop_ahead) const noexcept;
  Pair compare_momentum(const Drivers& drivers, Pair velocity_rad_s) noexcept;
  double compare_position(double velocity_rad_s, double step_rad, double elapsed_s) noexcept;
  double compare_force(double reading_N, double step_rad) noexcept;
  double compare_compression(double position_rad, double lagging_rad,
                             const ReadingContext& context) const noexcept;
  FaultCause verdict(const Levels& levels) const noexcept;
  FaultCause position_or_velocity() const noexcept;
  FaultCause torque_or_force(const Levels& levels) const noexcept;
  static FaultCause speed_verdict(const Levels& levels) noexcept;
  bool encoder_stands_still() const noexcept;

  static constexpr std::int64_t kNoSample = std::numeric_limits<std::int64_t>::min() / 2;

  ReadingTolerances tolerances_;
  Bounds bounds_;

  std::array<double, kForceLag> positions_rad_{};  ///< that go with forces_N_
  CommandedQuantity commanded_ = CommandedQuantity::Torque;
  Torques torques_Nm_{depth_at(bounds_.period_s)};
  Speeds speeds_;
  Forces forces_N_;
  double force_N_ = 0.0;  ///< their median

  std::int64_t index_ = kNoSample;  ///< of the last sample, whose readings the repeat watches know
  int settling_ = 0;                ///< samples until the histories are filled

  double torque_excess_Nm_ = 0.0;     ///< beyond the commands' range, accumulated over samples
  Pair speed_excess_rad_s_{};         ///< likewise, of both velocities
  double position_excess_rad_ = 0.0;  ///< travel that the velocity does not explain
  double common_speed_rad_s_ = 0.0;   ///< at which both readings say it moved lately
  double force_rate_N_ = 0.0;         ///< change of force a sample that the motion explains, lately
  double unanswered_N_ = 0.0;         ///< change of force that was due while the reading repeated
  Pair force_excess_N_{};             ///< how far changes of force lay outside of their bounds, accumulated
  Momentum momentum_;
  RepeatWatch velocity_repeats_{bounds_.period_s};
  RepeatWatch force_repeats_{bounds_.period_s};
  RepeatWatch position_repeats_{bounds_.period_s};
};

}  // namespace clampd::rt
