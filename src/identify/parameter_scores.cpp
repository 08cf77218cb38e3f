#include "clampd/identify/parameter_scores.hpp"

#include <algorithm>
#include <deque>
#include <vector>

#include "clampd/base/assert.hpp"
#include "src/identify/extended_run.hpp"
#include "src/identify/initial_state_prior.hpp"

namespace clampd {

using namespace identify;

namespace {

/// An estimate with as many further effects as one model holds, to be linearised once.
struct Part {
  explicit Part(const ExtendedEstimate& extended)
      : estimate(extended),
        brake(extended.parameters),
        unknowns(extended.parameters, brake.places(), {}, false),
        prior(prior_deviations(extended.parameters)) {}

  int parameters() const { return unknowns.count(); }
  int initial_states() const { return static_cast<int>(prior.size()); }
  /// Row by row, with its normal equations. False where the filter leaves all bounds.
  bool linearise(const FitRun& run, std::size_t number, ExtendedRun& linear) const {
    linear.resize(run.size(), brake.states(), parameters(), initial_states());
    if (!identify::linearise(run, brake, estimate.parameters, unknowns, estimate.initial_states[number],
                             variances_of(estimate.noise), Gains::Renewed, linear))
      return false;
    compute_normal(run, linear);
    return linear.normal.allFinite();
  }

  ExtendedEstimate estimate;
  ExtendedBrake brake;
  Unknowns unknowns;
  std::vector<double> prior;  ///< deviations of the initial states
};

/// The first one has the estimate's own model, whatever it has besides.
std::deque<Part> parts_of(const ExtendedEstimate& estimate, std::span<const EffectValues> beside) {
  std::deque<Part> parts;
  ExtendedEstimate extended = estimate;
  for (const EffectValues& effect : beside) {
    if (!room_for(extended.parameters, {&effect, 1})) {
      parts.emplace_back(extended);
      extended = estimate;
    }
    extended = with_effect(extended, effect);
  }
  parts.emplace_back(extended);
  return parts;
}

/// Several parts as one: the rows of [J e] are the parameters of the estimate, those of all effects beside
/// it, the initial states in the same order, and the innovations.
class Together {
 public:
  Together(const ExtendedEstimate& estimate, const std::deque<Part>& parts)
      : parts_(parts),
        known_(ExtendedBrake(estimate.parameters).parameters()),
        known_initial_(static_cast<int>(prior_deviations(estimate.parameters).size())),
        parameters_(known_) {
    prior_.assign(parts.front().prior.begin(), parts.front().prior.begin() + known_initial_);
    for (const Part& part : parts) {
      parameters_ += part.parameters() - known_;
      prior_.insert(prior_.end(), part.prior.begin() + known_initial_, part.prior.end());
    }
  }

  int parameters() const { return parameters_; }
  int initial_states() const { return static_cast<int>(prior_.size()); }
  const std::vector<double>& prior() const { return prior_; }

  /// False where the filter leaves all bounds with each part.
  bool linearise(const FitRun& run, std::size_t number, double& largest_innovation,
                 Eigen::MatrixXd& normal) const {
    ExtendedRun linear;
    Eigen::MatrixXd rows;
    int parameter = known_, initial = parameters_ + known_initial_;
    for (const Part& part : parts_) {
      const int own = part.parameters() - known_, own_initial = part.initial_states() - known_initial_;
      if (part.linearise(run, number, linear)) {
        const Eigen::Index readings = linear.innovations.cols();
        Eigen::MatrixXd all(linear.columns(), readings + (linear.off.size() > 0 ? 1 : 0));
        all.leftCols(readings) = linear.innovations;
        if (linear.off.size() > 0) all.rightCols(1) = linear.off;
        if (rows.size() == 0) {
          rows.setZero(parameters_ + initial_states() + 1, all.cols());
          rows.topRows(known_) = all.topRows(known_);
          rows.middleRows(parameters_, known_initial_) = all.middleRows(part.parameters(), known_initial_);
          rows.bottomRows(1) = all.bottomRows(1);
          largest_innovation =
              std::max(largest_innovation, linear.innovations.bottomRows(1).cwiseAbs().maxCoeff());
        }
        rows.middleRows(parameter, own) = all.middleRows(known_, own);
        rows.middleRows(initial, own_initial) =
            all.middleRows(part.parameters() + known_initial_, own_initial);
      }
      parameter += own;
      initial += own_initial;
    }
    if (rows.size() == 0) return false;
    normal.setZero(rows.rows(), rows.rows());
    normal.selfadjointView<Eigen::Lower>().rankUpdate(rows);
    normal.triangularView<Eigen::StrictlyUpper>() = normal.transpose();
    return true;
  }

  /// d parameter / d unknown of all parameters.
  Eigen::VectorXd slopes() const {
    Eigen::VectorXd slopes(parameters_);
    int at = 0;
    for (const Part& part : parts_)
      for (int i = at == 0 ? 0 : known_; i < part.parameters(); ++i)
        slopes[at++] = part.unknowns.slope(part.estimate.parameters, i);
    return slopes;
  }

 private:
  const std::deque<Part>& parts_;
  int known_, known_initial_;  ///< of the estimate alone
  int parameters_;
  std::vector<double> prior_;
};

}  // namespace

ParameterScores score_parameters(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                 std::span<const EffectValues> beside) {
  CLAMPD_ASSERT(estimate.initial_states.size() == runs.size());
  ParameterScores scores;
  if (!within_bounds(estimate.parameters)) return scores;
  const std::deque<Part> parts = parts_of(estimate, beside);
  const Together together(estimate, parts);
  const int p = together.parameters(), initial_states = together.initial_states();
  scores.gradient.setZero(p);
  scores.information.setZero(p, p);
  const Eigen::VectorXd slope = together.slopes();
  Eigen::MatrixXd normal;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    if (!together.linearise(runs[r], r, scores.largest_innovation, normal)) return scores;
    // What the initial state may answer, within its prior, does not count.
    add_prior(together.prior(), Eigen::VectorXd::Zero(initial_states).eval(), normal);
    const Reduced reduced = without_initial_states(normal, p, initial_states);
    const ParameterScores::OfRun& run = scores.of_runs.emplace_back(
        -reduced.gradient.cwiseQuotient(slope), reduced.information.cwiseQuotient(slope * slope.transpose()));
    scores.information += run.information;
    scores.gradient += run.gradient;
    scores.half_squares += 0.5 * reduced.sum_of_squares;
  }
  scores.possible = true;
  return scores;
}

}  // namespace clampd
