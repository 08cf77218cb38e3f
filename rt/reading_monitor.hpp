#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

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
  double velocity_rad_s = 25.0;  ///< change of speed beyond what torque, load and friction can explain
  double position_rad = 0.3;     ///< position against the integral of the velocity, beside 3 ms of motion
  double force_N = 2500.0;       ///< force against compression, beside 5 ms of motion and a few percent

  /// Error: a tolerance that is not positive and finite; the message names it.
  Result<void> validate() const;
};

/// Whether the reading of a sensor with noise has stopped changing. How often a healthy one repeats itself is
/// learned at rest; a sensor without noise may repeat itself for ever, and is judged by other means.
class RepeatWatch {
 public:
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

 private:
  static constexpr int kMax = 1'000'000;

  CLAMPD_REALTIME void learn() noexcept;

  double last_ = std::numeric_limits<double>::quiet_NaN();  ///< equals no reading
  int repeats_ = 0;
  int tolerated_ = kMax;  ///< any number, until the noise is known
  int learned_ = 0;       ///< samples at rest
  int longest_ = 0;       ///< row of equal readings at rest
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
  ReadingMonitor(const ReadingTolerances& tolerances, const NominalDrive& drive) noexcept
      : ReadingMonitor(tolerances, Bounds(drive)) {}

  /// Forgets everything but the commands: a check begins.
  CLAMPD_REALTIME void restart() noexcept;
  /// What was sent in a tick.
  CLAMPD_REALTIME void commanded(double torque_Nm) noexcept { commands_Nm_.push(torque_Nm); }

  /// The next sample. None, or the cause that names the reading.
  CLAMPD_REALTIME FaultCause observe(const BrakeFeedback& feedback, const ReadingContext& context) noexcept;

 private:
  struct Interval {
    double lower = 0.0;
    double upper = 0.0;
  };

  /// What a brake of this product may be, from the nominal one.
  struct Bounds {
    explicit Bounds(const NominalDrive& drive) noexcept;
    double slope_N_rad(double force_N) const noexcept;
    double slope_from_curve_N_rad(double force_N) const noexcept;
    double nominal_N(double compression_rad) const noexcept;
    DryFriction friction(double force_N) const noexcept;

    NominalDrive nominal;
    DryFriction unloaded;  ///< the most friction without force
    double load_friction_Nm_N = 0.0, viscous_Nm_s_rad = 0.0;
    double light_per_kg_m2 = 0.0, heavy_per_kg_m2 = 0.0;  ///< one over the least and the largest inertia
    double steep_rad = 0.0;  ///< compression to where the nominal stiffness is steep
    double top_rad = 0.0;    ///< compression of the largest force on the nominal curve
    /// The nominal stiffness at equal steps of the root of the force, over which it is nearly straight; the
    /// last step leads on.
    static constexpr int kSteps = 64;
    std::array<double, kSteps + 2> slopes_N_rad{};
    double steps2_N = 0.0;  ///< the square of a force's root in steps, over the force
  };

  /// The last readings, in no order.
  template <std::size_t n>
  class Last {
   public:
    void fill(double value) noexcept { values_.fill(value); }
    void push(double value) noexcept {
      values_[oldest_] = value;
      oldest_ = oldest_ + 1 < n ? oldest_ + 1 : 0;
    }
    const std::array<double, n>& values() const noexcept { return values_; }

   private:
    std::array<double, n> values_{};
    std::size_t oldest_ = 0;
  };

  /// Accumulates how far a change lies outside of its bounds, to either side.
  struct Excess {
    double above = 0.0;
    double below = 0.0;
    void add(double change, const Interval& bounds, double keep) noexcept;
    double larger() const noexcept { return std::max(above, below); }
  };

  /// The same of two velocities at once: the one that is read, and the one that the position's differences
  /// give. Two at a time cost as much as one.
  using Pair = double __attribute__((vector_size(16)));
  static constexpr int kRead = 0, kDifferentiated = 1;

  /// Two velocities against the torque.
  struct Momentum {
    Pair before_rad_s{};
    Pair above_rad_s{}, below_rad_s{};  ///< excess to either side, as in Excess
    Pair peak{};                        ///< of their levels, forgotten slowly
  };

  /// What moves the motor in one sample.
  struct Drivers {
    Interval torque_Nm;    ///< of the drive less the load of the force
    DryFriction friction;  ///< the most it may be
    double elapsed_s = 0.0;
    bool stop_ahead = false;
  };

  /// How large each contradiction is, as a share of what is tolerated; 1 is one.
  struct Levels {
    double torque = 0.0, position = 0.0, by_velocity = 0.0, by_position = 0.0, force = 0.0, compression = 0.0;
    bool velocity_stuck = false, force_stuck = false;
    bool contradict() const noexcept;
  };

  static constexpr int kHistory = 4;

  ReadingMonitor(const ReadingTolerances& tolerances, const Bounds& bounds) noexcept
      : tolerances_(tolerances), bounds_(bounds) {}
  static Interval range(const Last<kHistory>& last) noexcept;
  void begin_at(const BrakeFeedback& feedback) noexcept;
  double compare_torque(double reading_Nm, double samples) noexcept;
  Drivers drivers(double elapsed_s, bool stop_ahead) const noexcept;
  Pair compare_momentum(const Drivers& drivers, Pair velocity_rad_s) noexcept;
  double compare_position(double velocity_rad_s, double step_rad, double elapsed_s) noexcept;
  double compare_force(double reading_N, double step_rad) noexcept;
  double compare_compression(double position_rad, const ReadingContext& context) const noexcept;
  FaultCause verdict(const Levels& levels) const noexcept;
  FaultCause position_or_velocity() const noexcept;
  bool encoder_stands_still() const noexcept;

  ReadingTolerances tolerances_;
  Bounds bounds_;

  Last<kHistory> commands_Nm_;
  Last<kHistory> torques_Nm_;
  Last<5> forces_N_;
  double force_N_ = 0.0;  ///< their median

  bool has_previous_ = false;
  BrakeFeedback previous_;
  int settling_ = 0;  ///< samples until the histories are filled

  double torque_excess_Nm_ = 0.0;     ///< beyond the commands' range, accumulated over samples
  double position_excess_rad_ = 0.0;  ///< travel that the velocity does not explain
  double common_speed_rad_s_ = 0.0;   ///< at which both readings say it moved lately
  double force_rate_N_ = 0.0;         ///< change of force a sample that the motion explains, lately
  double unanswered_N_ = 0.0;         ///< change of force that was due while the reading repeated
  Excess force_excess_N_;
  Momentum momentum_;
  RepeatWatch velocity_repeats_;
  RepeatWatch force_repeats_;
  RepeatWatch position_repeats_;
};

}  // namespace clampd::rt
