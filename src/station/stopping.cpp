#include "clampd/station/stopping.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "clampd/base/assert.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/sheet/evaluation.hpp"
#include "clampd/station/cause.hpp"
#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/sequential.hpp"

namespace clampd {
namespace {

bool do_runs_differ_without_scatter(const Estimate& joint) {
  // With enough runs their scatter is the uncertainty, and they need not agree.
  return joint.runs_agree_p < kRunsDiffer && !joint.runs_differ;
}

bool is_fit_in_doubt(const std::optional<SystematicRecord>& systematic) {
  return systematic && systematic->p_value >= kSystematic && systematic->p_value < StoppingRule::kSeenToFit;
}

}  // namespace

namespace {

/// At each look, in any unit. Where runs are chosen, evenly from look to look up to the most: of all schedules
/// with so many looks and that ratio, the one whose looks hang together least.
std::vector<double> information_at_looks(std::uint32_t most, bool chooses) {
  constexpr double kFirst = StoppingRule::kFirstLook;
  std::vector<double> information;
  for (std::uint32_t runs = StoppingRule::kFirstLook; runs <= most; ++runs) {
    const double share = most > StoppingRule::kFirstLook ? (runs - kFirst) / (most - kFirst) : 0.0;
    information.push_back(chooses ? std::pow(StoppingRule::kMostInformation, share) : runs);
  }
  return information;
}

}  // namespace

StoppingRule::StoppingRule(double guard_band_k, std::uint32_t most, bool chooses)
    : most_(most),
      coverage_factor_(statistics::repeated_look_factor(statistics::normal_upper_tail(guard_band_k),
                                                        information_at_looks(most, chooses))) {
  CLAMPD_ASSERT(most >= kFirstLook);
}

GuardBands StoppingRule::guard_bands(const Estimate& joint) const {
  GuardBands bands{ParameterVector::Constant(coverage_factor_), coverage_factor_};
  for (Eigen::Index i = 0; i < bands.parameters.size(); ++i) {
    const double degrees = joint.degrees_of_freedom[i];
    if (!std::isfinite(degrees)) continue;
    bands.parameters[i] = statistics::with_estimated_deviation(coverage_factor_, degrees);
    // Reported deviations are already as much larger as 95 % intervals ask for; a scatter over the runs is
    // not.
    if (!joint.runs_differ)
      bands.parameters[i] *=
          statistics::normal_quantile(0.975) / statistics::student_t_upper_quantile(0.025, degrees);
  }
  if (joint.runs_differ) bands.effects = bands.parameters.maxCoeff();
  return bands;
}

namespace {

bool is_marginal(const auto& judged) {
  return judged.verdict == ParameterVerdict::Marginal;
}

/// Parameters and characteristics that their limits are too near to.
std::vector<std::string> in_doubt(const Judgement& judgement) {
  std::vector<std::string> names;
  for (const ParameterRecord& parameter : judgement.parameters)
    if (is_marginal(parameter)) names.push_back(parameter.name);
  for (const CharacteristicRecord& line : judgement.characteristics)
    if (is_marginal(line)) names.push_back(line.name);
  return names;
}

}  // namespace

bool StoppingRule::is_enough(const Judgement& judgement, const Estimate& joint,
                             const std::optional<SystematicRecord>& systematic) {
  return is_about_the_brake(judgement.verdict) && in_doubt(judgement).empty() &&
         !do_runs_differ_without_scatter(joint) && !is_fit_in_doubt(systematic);
}

std::string StoppingRule::why_most(const Judgement& judgement, const Estimate& joint,
                                   const std::optional<SystematicRecord>& systematic) const {
  std::string why;
  if (const std::vector<std::string> doubt = in_doubt(judgement); !doubt.empty())
    why = fmt::format("; {} in doubt", fmt::join(doubt, ", "));
  else if (do_runs_differ_without_scatter(joint))
    why = "; the runs differ from each other by more than their noise";
  else if (!is_about_the_brake(judgement.verdict))
    why = "; they say nothing about the brake";
  else if (is_fit_in_doubt(systematic))
    why = "; whether the model fits is in doubt";
  return fmt::format("the most that was allowed: {}{}", most_, why);
}

namespace {

/// Sum of the logarithms of the standard deviations, under this covariance, of what is in doubt. NaN where
/// one is not known.
double log_deviations(const Posterior& expected, const Judgement& judgement,
                      std::span<const Characteristic> sheet, const NominalDrive& drive) {
  double sum = 0.0;
  for (const ParameterRecord& parameter : judgement.parameters) {
    const auto index = find_parameter(parameter.name);
    if (!is_marginal(parameter) || !index) continue;
    const auto k = static_cast<Eigen::Index>(*index);
    sum += 0.5 * std::log(expected.covariance_normalised(k, k));
  }
  if (std::none_of(judgement.characteristics.begin(), judgement.characteristics.end(), is_marginal<CharacteristicRecord>))
    return sum;
  const std::vector<CharacteristicEstimate> lines = evaluate(sheet, expected, drive);
  for (std::size_t i = 0; i < lines.size(); ++i)
    if (is_marginal(judgement.characteristics[i])) sum += std::log(lines[i].sd);
  return sum;
}

}  // namespace

std::uint8_t next_trajectory_for(const Judgement& judgement, const Estimate& joint,
                                 const std::vector<RunRecord>& runs, const TrajectorySet& trajectories,
                                 std::span<const Characteristic> sheet) {
  if (trajectories.size() < 2 || in_doubt(judgement).empty() || !joint.converged()) return 0;
  std::vector<double> driven(trajectories.size(), 0.0);
  for (const RunRecord& run : runs)
    if (run.trajectory < driven.size()) driven[run.trajectory] += 1.0;
  const NextRunValue value = trajectories.value_of_next(joint, driven);
  // What the encoder tells gets better by one more run of any kind alike; where the brake was found changes
  // nothing.
  Posterior expected{
      .parameters = joint.parameters, .contact = contact_point(runs_of(runs), joint), .found_rad = 0.0};
  std::uint8_t best = 0;
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k < value.after.size(); ++k) {
    expected.covariance_normalised = value.after[k];
    const double sum = log_deviations(expected, judgement, sheet, trajectories.drive());
    if (!(sum < least)) continue;
    best = static_cast<std::uint8_t>(k);
    least = sum;
  }
  return best;
}

}  // namespace clampd
