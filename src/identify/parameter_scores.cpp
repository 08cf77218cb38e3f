#include "clampd/identify/parameter_scores.hpp"

#include <algorithm>

#include "clampd/base/assert.hpp"
#include "src/identify/extended_run.hpp"
#include "src/identify/initial_state_prior.hpp"

namespace clampd {

using namespace identify;

ParameterScores score_parameters(std::span<const FitRun> runs, const ExtendedEstimate& estimate) {
  CLAMPD_ASSERT(estimate.initial_states.size() == runs.size());
  ParameterScores scores;
  if (!within_bounds(estimate.parameters)) return scores;
  const ExtendedBrake brake(estimate.parameters);
  const Unknowns unknowns(estimate.parameters, brake.places(), {}, false);
  const int p = unknowns.count();
  const std::vector<double> prior = prior_deviations(estimate.parameters);
  const int initial_states = static_cast<int>(prior.size());
  scores.gradient.setZero(p);
  scores.information.setZero(p, p);
  ExtendedRun linear;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    linear.resize(runs[r].size(), brake.states(), p, initial_states);
    if (!linearise(runs[r], brake, estimate.parameters, unknowns, estimate.initial_states[r],
                   variances_of(estimate.noise), Gains::Renewed, linear))
      return scores;
    compute_normal(runs[r], linear);
    if (!linear.normal.allFinite()) return scores;
    scores.largest_innovation =
        std::max(scores.largest_innovation, linear.innovations.row(p + initial_states).cwiseAbs().maxCoeff());
    // What the initial state may answer, within its prior, does not count.
    add_prior(prior, Eigen::VectorXd::Zero(initial_states).eval(), linear.normal);
    const Reduced reduced = without_initial_states(linear.normal, p, initial_states);
    scores.information += reduced.information;
    scores.gradient -= reduced.gradient;
    scores.half_squares += 0.5 * reduced.sum_of_squares;
  }
  Eigen::VectorXd slope(p);
  for (int i = 0; i < p; ++i) slope[i] = unknowns.slope(estimate.parameters, i);
  scores.gradient = scores.gradient.cwiseQuotient(slope).eval();
  scores.information = scores.information.cwiseQuotient(slope * slope.transpose()).eval();
  scores.possible = true;
  return scores;
}

}  // namespace clampd
