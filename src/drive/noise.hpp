#pragma once

#include <vector>

#include <Eigen/Core>

#include "src/drive/rows.hpp"

namespace clampd::drive {

/// The noise of a torque balance: white, and a part with a memory (Ornstein and Uhlenbeck).
struct RowNoise {
  double memory_share = 0.0;  ///< of the variance, what has a memory
  double memory_s = 1.0;      ///< after which it is down to 1/e
};

/// Makes rows' noise white, by the innovations of a Kalman filter that knows gaps and the ends of runs.
class Whitener {
 public:
  Whitener(const DriveData& data, const RowNoise& noise);

  /// One value a row, all runs one below the other.
  Eigen::VectorXd operator()(const Eigen::VectorXd& column) const;
  double log_determinant() const { return log_determinant_; }

 private:
  struct Step {
    double decay = 0.0, gain = 0.0, scale = 1.0;  ///< scale: one over the innovation's standard deviation
  };
  std::vector<Step> steps_;
  double log_determinant_ = 0.0;
};

/// The most likely noise of these residuals.
RowNoise noise_of(const DriveData& data, const Eigen::VectorXd& residuals);

}  // namespace clampd::drive
