#include "clampd/identify/parameter_scores.hpp"

#include <algorithm>

#include <Eigen/Cholesky>

#include "clampd/base/assert.hpp"
#include "src/identify/extended_run.hpp"

namespace clampd {

using namespace identify;

ParameterScores score_parameters(std::span<const FitRun> runs, const ExtendedEstimate& estimate) {
  CLAMPD_ASSERT(estimate.initial_states.size() == runs.size());
  ParameterScores scores;
  if (!within_bounds(estimate.parameters)) return scores;
  const ExtendedBrake brake(estimate.parameters);
  const Unknowns unknowns(estimate.parameters, brake.places(), {}, false);
  const int p = unknowns.count();
  const int locals = 2 + static_cast<int>(brake.free_states().size());
  scores.gradient.setZero(p);
  scores.information.setZero(p, p);
  ExtendedRun linear;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    linear.resize(runs[r].size(), brake.states(), p, locals);
    if (!linearise(runs[r], brake, estimate.parameters, unknowns, estimate.initial_states[r],
                   variances_of(estimate.noise), Gains::Renewed, linear))
      return scores;
    compute_normal(runs[r], linear);
    if (!linear.normal.allFinite()) return scores;
    scores.largest_innovation =
        std::max(scores.largest_innovation, linear.innovations.row(p + locals).cwiseAbs().maxCoeff());
    // What the initial state may answer, within its prior, does not count.
    Eigen::MatrixXd local_block = linear.normal.block(p, p, locals, locals);
    local_block(0, 0) += 1.0 / (kInitialPositionPrior_rad * kInitialPositionPrior_rad);
    local_block(1, 1) += 1.0 / (kInitialVelocityPrior_rad_s * kInitialVelocityPrior_rad_s);
    for (int i = 2; i < locals; ++i) local_block(i, i) += 1e-10;
    const Eigen::LDLT<Eigen::MatrixXd> factor(local_block);
    const Eigen::MatrixXd cross = linear.normal.block(p, 0, locals, p);
    const Eigen::VectorXd right = linear.normal.block(p, p + locals, locals, 1);
    scores.information += linear.normal.topLeftCorner(p, p) - cross.transpose() * factor.solve(cross);
    scores.gradient -= linear.normal.block(0, p + locals, p, 1) - cross.transpose() * factor.solve(right);
    scores.half_squares += 0.5 * (linear.normal(p + locals, p + locals) - right.dot(factor.solve(right)));
  }
  Eigen::VectorXd slope(p);
  for (int i = 0; i < p; ++i) slope[i] = unknowns.slope(estimate.parameters, i);
  scores.gradient = scores.gradient.cwiseQuotient(slope).eval();
  scores.information = scores.information.cwiseQuotient(slope * slope.transpose()).eval();
  scores.possible = true;
  return scores;
}

}  // namespace clampd
