#pragma once

#include <span>
#include <vector>

#include "clampd/control/nominal_drive.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/record/reference.hpp"

namespace clampd {

/// What one more run would do for a joint estimate: covariances of theta / theta_nom.
struct NextRunValue {
  ParameterMatrix now;                 ///< expected of the runs so far
  std::vector<ParameterMatrix> after;  ///< after one more along each trajectory; NaN: not to be driven
};

/// The trajectories that a station can drive, to judge the next run by. Read-only once built; any thread.
class TrajectorySet {
 public:
  TrajectorySet() = default;
  /// `drive`: of the brake and the period that the references are built for, as the loop knows it.
  TrajectorySet(std::vector<Reference> references, const NominalDrive& drive, double torque_limit_Nm);

  std::size_t size() const { return references_.size(); }
  const NominalDrive& drive() const { return drive_; }

  /// By simulation of the estimated brake under the station's control law, with the noise as estimated.
  /// `driven`: runs so far along each trajectory. A trajectory that the loop cannot keep this brake on is not
  /// to be driven. The covariance is that of the estimate's method, linear in the noise
  /// (expected_covariance()); of a model with effects, that of its base model.
  NextRunValue value_of_next(const Estimate& joint, std::span<const double> driven) const;

 private:
  std::vector<Reference> references_;
  NominalDrive drive_;
  double torque_limit_Nm_ = 0.0;
};

}  // namespace clampd
