#pragma once

#include <array>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/brake/dynamics.hpp"
#include "clampd/brake/integrator.hpp"
#include "clampd/brake/sensitivity.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

/// The sensitivities of a run of the paper's brake under block torques, and the derivatives of any function
/// of them by these torques: one sweep forward, one (the adjoint, of second order) back. States are those of
/// simulate(), sensitivities those of its sensitivity simulation, up to rounding. The back sweep is exact
/// where a step slides in one direction or sticks; the few steps in which the brake comes to rest or turns
/// enter it by central differences of their exact first derivatives.
class SensitivitySweep {
 public:
  /// Of force and velocity in turn, by the normalised parameters, over their noise.
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, static_cast<int>(kParameterCount), Eigen::RowMajor>;

  SensitivitySweep(const BrakeParameters& brake, const SensorNoise& noise, std::size_t samples,
                   std::size_t block_samples);

  /// One run. False if it leaves the model's range; then the rows are meaningless.
  bool forward(const BrakeState& initial, std::span<const double> block_torque_Nm);

  std::size_t samples() const { return samples_; }
  const std::vector<double>& force_N() const { return force_N_; }
  const std::vector<double>& velocity_rad_s() const { return velocity_rad_s_; }
  const Rows& sensitivity() const { return sensitivity_; }  ///< 2 samples x 7
  /// Change of the velocity per error common to all torques, rad/s per N m.
  double amplification(std::size_t row) const { return steps_[row].velocity[kTorque]; }

  /// The amplification of one row in a functional.
  struct AmplificationTerm {
    std::size_t row;
    double weight;
  };
  /// Adds d(sum over weights .* sensitivity + the term) / d(block torque) per N m; `weights` as
  /// sensitivity().
  void backward(const Rows& weights, const AmplificationTerm& term, std::span<double> gradient) const;
  /// The same of the term alone.
  void backward_amplification(const AmplificationTerm& term, std::span<double> gradient) const;
  /// Derivatives of force and velocity of a row by the torque of each block; zero for later blocks.
  void output_gradients(std::size_t row, std::span<double> force, std::span<double> velocity) const;

 private:
  // Columns that are propagated: seven normalised parameters and the torque common to all blocks, whose
  // derivatives the back sweep gives; then, started anew in each block, position, velocity and torque.
  static constexpr int kTorque = static_cast<int>(kParameterCount);
  static constexpr int kCurved = kTorque + 1;
  static constexpr int kRestarted = kCurved;
  static constexpr int kColumns = kCurved + 4;  // the last one pads
  using Curved = Eigen::Array<double, kCurved, 1>;
  using Columns = std::array<double, static_cast<std::size_t>(kColumns)>;

  enum class Motion { Stuck, Sliding, Event };
  /// From a sample to the next; what the back sweep needs of it.
  struct Step {
    Columns position;  ///< of the state at the sample
    Columns velocity;
    BrakeState state;
    double torque_Nm;
    double sign;
    Motion motion;
  };
  /// A step linearised; columns as in Curved.
  struct Linear {
    Eigen::Matrix2d transition;
    Eigen::Matrix<double, 2, kCurved> input;
  };
  struct Point;
  struct Adjoint;

  Point point_at(double position, double velocity, double torque_Nm, double sign) const;
  BrakeState slide(const Step& step, Columns& position, Columns& velocity) const;
  Linear linearise(const BrakeState& state, double torque_Nm, BrakeState* reached) const;
  void record(std::size_t row);
  void back_slide(const Step& step, Adjoint& adjoint) const;
  void back_event(const Step& step, Adjoint& adjoint) const;
  void back_step(const Step& step, Adjoint& adjoint) const;

  PaperBrake model_;
  Curved scale_;  ///< from the columns to SI: theta_nom, and 1
  double inverse_inertia_;
  double ratio_m_rad_;
  std::array<double, kParameterCount> theta_;
  SensorNoise noise_;
  std::size_t samples_;
  std::size_t block_samples_;
  struct BlockEnd {
    Columns position;
    Columns velocity;
  };
  std::vector<Step> steps_;           ///< one per sample
  std::vector<BlockEnd> block_ends_;  ///< the restarted columns at the first sample of the next block
  std::vector<double> force_N_;
  std::vector<double> velocity_rad_s_;
  Rows sensitivity_;
};

}  // namespace clampd
