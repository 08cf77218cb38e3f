#include "clampd/station/stopping.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "clampd/base/assert.hpp"
#include "clampd/record/check_record.hpp"
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

StoppingRule::StoppingRule(double guard_band_k, std::uint32_t most)
    : most_(most),
      coverage_factor_(statistics::repeated_look_factor(statistics::normal_upper_tail(guard_band_k),
                                                        static_cast<int>(kFirstLook),
                                                        static_cast<int>(most))) {
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

/// Parameters and characteristics that their limits are too near to.
std::vector<std::string> in_doubt(const Judgement& judgement) {
  std::vector<std::string> names;
  for (const ParameterRecord& parameter : judgement.parameters)
    if (parameter.verdict == ParameterVerdict::Marginal) names.push_back(parameter.name);
  for (const CharacteristicRecord& line : judgement.characteristics)
    if (line.verdict == ParameterVerdict::Marginal) names.push_back(line.name);
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

}  // namespace clampd
