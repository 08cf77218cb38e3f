#pragma once

#include <array>
#include <span>
#include <vector>

#include "src/identify/linear_run.hpp"

namespace clampd::identify {

using Held = std::array<bool, kParameterCount>;

/// The normal equations of several runs with every run's initial state eliminated.
struct JointNormal {
  ParameterMatrix information = ParameterMatrix::Zero();  ///< unit rows and columns for held parameters
  ParameterVector gradient = ParameterVector::Zero();     ///< zero for held parameters
  double sum_of_squares = 0.0;                            ///< weighted, initial states at their optimum
  double log_determinant = 0.0;                           ///< of all initial states' information
};

/// The step of the parameters to the minimum of their normal equations. Allocates nothing: a search calls it
/// at every point.
ParameterVector step_to_minimum(const JointNormal& joint) noexcept;

/// `normals` with the prior of the initial states in them.
JointNormal eliminate_initial_states(std::span<const Normal> normals, const Held& held) noexcept;

/// theta rows of a run: its 7 x 2 coefficients of the initial state, so that eliminated = theta part -
/// coefficients * initial-state part.
Eigen::Matrix<double, kTheta, 2> elimination(const Normal& normal) noexcept;

}  // namespace clampd::identify
