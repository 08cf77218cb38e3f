#pragma once

#include <algorithm>
#include <cmath>

#include <ceres/tiny_solver.h>
#include <Eigen/Core>

namespace clampd::identify {

namespace minimiser {

/// Decrease of the weighted squares, per unknown, at which a fit ends: a last step of a twentieth of a
/// standard deviation each. The cost has faint kinks, where a stop crosses a sample, that make a finer search
/// bounce.
inline constexpr double kToleranceEach = 2.5e-3;

/// From this expected decrease per unknown on a step that fails to bring it is an end too: a kink.
inline constexpr double kNearTheEndEach = 0.035;

/// Iterations in one go, far from the end; near it one at a time, to look whether anything is left to gain.
inline constexpr int kRoundIterations = 8;

/// Trust region (over the information) of a step that is Gauss-Newton's, and of the first one that is not.
inline constexpr double kGaussNewton = 1e4;
inline constexpr double kShorter = 1e2;

/// Gauss-Newton steps to leap beyond a kink.
inline constexpr double kFirstLeap = 1.0;
inline constexpr double kLastLeap = 4.0;
inline constexpr int kLeapIterations = 6;

}  // namespace minimiser

/// Stands for the cost where a model cannot be simulated, so that the solver steps back.
inline constexpr double kImpossible = 1e30;

/// Upper triangular U with U^T U = matrix, rows of vanishing pivots zero: a column that the data say nothing
/// about.
template <class Matrix>
Matrix semidefinite_factor(const Matrix& matrix) {
  const Eigen::Index size = matrix.rows();
  Matrix factor = Matrix::Zero(size, size);
  for (Eigen::Index i = 0; i < size; ++i) {
    const double pivot = matrix(i, i) - factor.col(i).head(i).squaredNorm();
    if (!(pivot > 1e-14 * matrix(i, i))) continue;
    const double root = std::sqrt(pivot);
    for (Eigen::Index j = i; j < size; ++j)
      factor(i, j) = (matrix(i, j) - factor.col(i).head(i).dot(factor.col(j).head(i))) / root;
  }
  return factor;
}

struct Descent {
  bool possible = false;  ///< the fit can be evaluated at the unknowns reached
  bool settled = false;   ///< nothing more to gain
  bool at_kink = false;   ///< though the slopes there promise more
  int iterations = 0;
};

/// Minimises a fit from `unknowns` by ceres::TinySolver, whose functor the fit is; besides, it tells
/// sum_of_squares(), expected_decrease() and gauss_newton_step() at the point evaluated last, and is told by
/// try_out() whether most points will be left again; if it has an inside(), that is where the unknowns stay;
/// if it has a stay_near(), it is told where each solve begins.
template <class Fit>
class MinimiserOf {
 public:
  enum class Kinks { Accept, LookBeyond };
  MinimiserOf(const Fit& fit, Kinks kinks) : kinks_(kinks), beyond_(fit.NumParameters()) {}
  Descent operator()(Fit& fit, Eigen::VectorXd& unknowns, int max_iterations);

 private:
  Descent descend(Fit& fit, Eigen::VectorXd& unknowns, int max_iterations);

  Kinks kinks_;
  Eigen::VectorXd beyond_;
  ceres::TinySolver<Fit> solver_;
};

template <class Fit>
Descent MinimiserOf<Fit>::descend(Fit& fit, Eigen::VectorXd& unknowns, int max_iterations) {
  const double tolerance = minimiser::kToleranceEach * fit.NumParameters();
  Descent descent;
  descent.possible = fit.evaluate(unknowns);
  bool stalled = false;
  bool has_stalled = false;
  while (descent.possible && descent.iterations < max_iterations) {
    const double expected = fit.expected_decrease();
    descent.at_kink = stalled && expected >= tolerance;
    descent.settled =
        expected < tolerance || (stalled && expected < minimiser::kNearTheEndEach * fit.NumParameters());
    if (descent.settled) break;
    const double before = fit.sum_of_squares();
    // One step, and only if that fails the solver's own search for a shorter one.
    const int steps =
        std::min(stalled ? minimiser::kRoundIterations : 1, max_iterations - descent.iterations);
    solver_.options.max_num_iterations = 1 + steps;
    solver_.options.initial_trust_region_radius = stalled ? minimiser::kShorter : minimiser::kGaussNewton;
    fit.try_out(has_stalled);
    if constexpr (requires { fit.stay_near(unknowns); }) fit.stay_near(unknowns);
    solver_.Solve(fit, &unknowns);
    if constexpr (requires { fit.inside(unknowns); }) unknowns = fit.inside(unknowns);
    descent.iterations += std::clamp(solver_.summary.iterations, 1, steps);
    descent.possible = fit.evaluate(unknowns);
    const bool stuck = stalled;
    stalled = !(before - fit.sum_of_squares() > 0.1 * std::min(expected, 1.0));
    has_stalled = has_stalled || stalled;
    if (stuck && stalled) {
      descent.settled = descent.at_kink = true;
      break;
    }
  }
  return descent;
}

template <class Fit>
Descent MinimiserOf<Fit>::operator()(Fit& fit, Eigen::VectorXd& unknowns, int max_iterations) {
  solver_.options.function_tolerance = minimiser::kToleranceEach * fit.NumParameters();
  solver_.options.parameter_tolerance = 1e-9;
  Descent descent = descend(fit, unknowns, max_iterations);
  if (kinks_ == Kinks::Accept) return descent;
  // A kink can be a minimum of its own with a lower one close behind it: look there.
  for (double leap = minimiser::kFirstLeap; descent.at_kink && leap <= minimiser::kLastLeap; leap *= 2.0) {
    const double reached = fit.sum_of_squares();
    fit.gauss_newton_step(beyond_);
    beyond_ = unknowns + leap * beyond_;
    const Descent other = descend(fit, beyond_, minimiser::kLeapIterations);
    descent.iterations += other.iterations;
    if (other.possible && fit.sum_of_squares() < reached - minimiser::kToleranceEach * fit.NumParameters()) {
      unknowns = beyond_;
      descent.at_kink = other.at_kink;
      leap = 0.5 * minimiser::kFirstLeap;
    } else {
      fit.evaluate(unknowns);
    }
    if (descent.iterations >= max_iterations) break;
  }
  return descent;
}

}  // namespace clampd::identify
