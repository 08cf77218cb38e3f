#pragma once

#include <optional>
#include <string_view>

#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

/// What an experiment minimises. Both are functions of the Fisher information M of the normalised parameters
/// alone.
enum class Objective {
  D,  ///< volume of the confidence ellipsoid: -log det M
  A,  ///< mean variance: trace of the inverse of M
};
std::string_view to_string(Objective objective) noexcept;
std::optional<Objective> parse_objective(std::string_view name) noexcept;

/// Both measures of one experiment, smaller is better; infinite where M is not positive definite.
struct Criterion {
  double logdet;         ///< -log det M
  double trace_inverse;  ///< trace of the inverse of M: sum of the variances of theta / theta_nom
};
Criterion criterion_of(const ParameterMatrix& information) noexcept;

/// The scalar that the optimiser minimises, -log det M or log trace M^-1 (the logarithm makes both of the
/// same scale), and its derivative dJ = trace(slope * dM).
struct ObjectivePoint {
  double value;  ///< infinite where M is not positive definite; then the slope is zero
  ParameterMatrix slope;
};
ObjectivePoint evaluate(Objective objective, const ParameterMatrix& information) noexcept;

}  // namespace clampd
