#pragma once

#include <vector>

#include "src/diagnose/drive_fitted.hpp"

namespace clampd::drive {

/// A misfit that takes off less than this share of the squared error is not worth a word.
inline constexpr double kMaterialShare = 0.02;

/// Ljung and Box over ten lags.
MisfitTest whiteness(const Eigen::VectorXd& residuals);

std::vector<MisfitTest> tests_of(const Fitted& model, const DriveFit& fit);

/// What is left, as a function of a variable.
struct DependenceTest {
  Dependence dependence;
  double share = 0.0;  ///< of the squared error
  bool holds = false;  ///< blocks left out agree
};

/// What is left depends on, the strongest first.
std::vector<DependenceTest> dependences(const Fitted& model, const DriveFit& fit, double false_alarm);

}  // namespace clampd::drive
