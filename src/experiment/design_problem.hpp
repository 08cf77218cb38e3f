#pragma once

#include <algorithm>
#include <cstdint>
#include <random>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/experiment/certification.hpp"
#include "clampd/experiment/criterion.hpp"
#include "clampd/experiment/optimal_design.hpp"
#include "sensitivity_sweep.hpp"

namespace clampd {

/// Procedure 1 as a nonlinear programme over the torques of the blocks, in units of the torque limit. One
/// object per thread: evaluations reuse its buffers.
///
/// Constraints, each c <= 0, per block the largest force and the largest speed among its samples, relative to
/// their limits; then the logarithm of the amplification if that is limited; then the speed at the end if
/// that is. That keeps the programme small: a block moves its extremes as a whole.
class DesignProblem {
 public:
  /// `tightening`: share by which the limits on force and speed are undercut.
  DesignProblem(const DesignOptions& options, double tightening);

  std::size_t blocks() const { return blocks_; }
  std::size_t constraints() const {
    return 2 * blocks_ + (amplification_limited_ ? 1 : 0) + (end_limited_ ? 1 : 0);
  }

  /// Objective and constraints at `x`; repeated calls for the same point cost nothing.
  void evaluate(std::span<const double> x);
  /// Their gradients at `x` as well.
  void differentiate(std::span<const double> x);

  /// Whether M of `x` holds over changes of the parameters by a hundred-thousandth, as difference quotients
  /// tell. Designs on the verge of a lock-up are good for one brake only.
  bool is_steady(std::span<const double> x);

  /// Makes the next evaluation cost what it costs, whatever this object was used for before.
  void forget() { evaluated_ = differentiated_ = false; }

  /// With the price of the amplification; infinite where M is singular or the run diverges.
  double objective() const { return objective_; }
  const Eigen::VectorXd& constraint_values() const { return constraint_; }
  const Eigen::VectorXd& objective_gradient() const { return objective_gradient_; }
  const Eigen::MatrixXd& constraint_gradient() const { return constraint_gradient_; }  ///< constraint x block
  double violation() const { return std::max(0.0, constraint_.maxCoeff()); }
  const ParameterMatrix& information() const { return information_; }

  /// Replaces x from block `from` on by random torques that, where possible, keep the limits.
  void random_tail(std::mt19937_64& random, std::size_t from, std::span<double> x);

  /// Runs simulated, gradients not counted.
  std::int64_t simulations() const { return simulations_; }

 private:
  Eigen::Index amplification_row() const { return static_cast<Eigen::Index>(2 * blocks_); }
  Eigen::Index end_row() const { return amplification_row() + (amplification_limited_ ? 1 : 0); }
  bool keeps_limits(BrakeState& state, double torque_Nm) const;
  void differentiate_constraints();

  PaperBrake model_;
  BrakeParameters brake_;
  SensorNoise noise_;
  BrakeState initial_;
  std::size_t samples_;
  std::size_t block_samples_;
  std::size_t blocks_;
  Objective kind_;
  double caution_;
  bool amplification_limited_;
  bool end_limited_;
  double torque_limit_Nm_;
  double force_limit_N_;
  double speed_limit_rad_s_;
  double end_speed_limit_rad_s_;
  double amplification_limit_;
  double ratio_m_rad_;
  double inertia_kg_m2_;

  std::vector<double> point_;
  bool evaluated_ = false;
  bool differentiated_ = false;
  SensitivitySweep sweep_;
  Simulation above_;
  Simulation below_;
  SensitivitySweep::Rows differences_;
  std::vector<double> block_torque_Nm_;
  std::vector<std::size_t> force_peak_;
  std::vector<std::size_t> speed_peak_;
  std::size_t amplification_peak_ = 0;
  SensitivitySweep::Rows weights_;
  ParameterMatrix information_;
  ParameterMatrix slope_;
  double objective_ = 0.0;
  Eigen::VectorXd constraint_;
  Eigen::VectorXd objective_gradient_;
  Eigen::MatrixXd constraint_gradient_;
  std::int64_t simulations_ = 0;
};

}  // namespace clampd
