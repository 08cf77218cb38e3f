#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "src/drive/selection.hpp"

namespace clampd::drive {

/// What a free function of all columns takes of the squared rest, from which on something is missing however
/// small the rest is.
inline constexpr double kStructured = 0.25;

/// What a model leaves of the torque, judged by rows that it was not fitted to.
struct Remainder {
  double variation = 0.0;  ///< root mean square of the torque about its mean
  double left = 0.0;       ///< root mean square that is left on rows that were not fitted
  double share = 0.0;      ///< of the two
  double noise =
      0.0;  ///< root mean square that the readings' own noise accounts for, independent of the model
  double correlation = 0.0;  ///< of neighbouring rows
  double explainable =
      0.0;  ///< share of the square that a function of all columns takes where it was not fitted
  bool is_noise() const;
  /// As little as the user asks for, or no more than noise.
  bool is_enough(double good_enough) const { return share < good_enough || is_noise(); }
};
Remainder remainder_of(const Design& design, const TorqueModel& model, double inertia);

/// What is left, as a function of one variable (and, beside it, of it in each direction).
struct DependenceTest {
  Dependence dependence;
  double share = 0.0;  ///< of the squared error of rows that were not fitted
};
/// The strongest first.
std::vector<DependenceTest> dependences(const Design& design, const TorqueModel& model,
                                        const DriveModel& drive);

/// Share of the square of `residuals` that a free function of the variable takes where it was not fitted.
double free_function_share(const Design& design, const Eigen::VectorXd& residuals,
                           const Eigen::VectorXd& variable);
Eigen::VectorXd variable_of(const Design& design, std::string_view name, const DriveModel& drive);

/// Of what is left, the share that any function of the recorded columns takes where it was not fitted; NaN
/// with few rows.
double explainable_share(const Design& design, const TorqueModel& model, const DriveModel& drive);

/// As many independent rows leave as much information as the model's residuals: rows over the sum of their
/// autocorrelation up to its first zero.
double independent_rows(const Design& design, const TorqueModel& model);

std::vector<MisfitTest> tests_of(const Design& design, const TorqueModel& model, const Remainder& remainder,
                                 std::string_view effort);

}  // namespace clampd::drive
