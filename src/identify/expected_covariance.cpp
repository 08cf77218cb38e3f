#include "clampd/identify/expected_covariance.hpp"

#include "clampd/base/assert.hpp"
#include "clampd/base/nan.hpp"
#include "src/identify/initial_state_prior.hpp"
#include "src/identify/linear_run.hpp"
#include "src/identify/uncertainty.hpp"

namespace clampd {

ExpectedContribution expected_contribution(Method method, const BrakeParameters& parameters,
                                           const BrakeState& initial, const Excitation& excitation,
                                           const NoiseLevels& noise) {
  using namespace identify;
  LinearRun linear;
  linear.resize(excitation.size());
  if (!linearise(run_without_readings(excitation), parameters, initial, linear))
    return {ParameterMatrix::Constant(kNaN), ParameterMatrix::Constant(kNaN)};
  const Variances variances = variances_of(noise);
  if (method == Method::OutputError)
    ignore_torque_noise(variances, {}, linear);
  else
    update_gains(variances, {}, linear);
  Normal normal = normal_equations(linear);
  const ScoreMoments moments =
      score_moments({}, Eigen::Matrix<double, kUnknowns, 1>::Zero(), linear);
  add_prior(kInitialStatePrior, Eigen::Vector2d(Eigen::Vector2d::Zero()), normal);
  const RunScore score = run_score(normal, moments, variances);
  return {score.eliminate * normal.topLeftCorner<kUnknowns, kTheta>(), score.by_readings + score.by_torque};
}

ParameterMatrix expected_covariance(std::span<const ExpectedContribution> contributions,
                                    std::span<const double> counts) {
  CLAMPD_ASSERT(contributions.size() == counts.size());
  ExpectedContribution sum{ParameterMatrix::Zero(), ParameterMatrix::Zero()};
  for (std::size_t i = 0; i < counts.size(); ++i) {
    if (counts[i] == 0.0) continue;
    sum.information += counts[i] * contributions[i].information;
    sum.scatter += counts[i] * contributions[i].scatter;
  }
  const ParameterMatrix inverse = cramer_rao(sum.information);
  return inverse * sum.scatter * inverse;
}

}  // namespace clampd
