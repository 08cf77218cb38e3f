#include "clampd/station/verdict.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace clampd {
namespace {

bool is_inside(const ParameterRecord& parameter) {
  return parameter.value >= parameter.lower && parameter.value <= parameter.upper;
}

std::string describe(const ParameterRecord& parameter) {
  const bool low = parameter.value - parameter.lower < parameter.upper - parameter.value;
  return fmt::format("{} is {:.4g} {}, {} its {} limit {:.4g} {}", parameter.name, parameter.value,
                     parameter.unit, is_inside(parameter) ? "close to" : (low ? "below" : "above"),
                     low ? "lower" : "upper", low ? parameter.lower : parameter.upper, parameter.unit);
}

template <class Predicate>
std::string describe_all(const std::vector<ParameterRecord>& parameters, Predicate wanted) {
  std::string text;
  for (const ParameterRecord& parameter : parameters) {
    if (!wanted(parameter)) continue;
    if (!text.empty()) text += "; ";
    text += describe(parameter);
  }
  return text;
}

/// Why nothing can be said about the brake; empty if something can.
std::string invalidity(const CheckFacts& facts, const ValiditySettings& validity) {
  if (facts.samples_lost > validity.lost_samples_max)
    return fmt::format("{} samples got lost ({} allowed): check the bus and the station's load.",
                       facts.samples_lost, validity.lost_samples_max);
  if (facts.ticks_skipped > validity.skipped_ticks_max)
    return fmt::format(
        "The loop missed {} of its ticks ({} allowed): this machine was not in time; see `clampctl doctor`.",
        facts.ticks_skipped, validity.skipped_ticks_max);
  if (!facts.problem.empty()) return fmt::format("A run cannot be used: {}.", facts.problem);
  if (facts.repeats_recorded < facts.repeats_planned)
    return fmt::format("Only {} of {} repeats were recorded.", facts.repeats_recorded, facts.repeats_planned);
  if (!facts.estimated || !facts.estimate.allFinite() || !facts.sd.allFinite() ||
      (facts.sd.array() < 0.0).any())
    return fmt::format("No parameters could be identified from the runs{}{}.",
                       facts.estimate_text.empty() ? "" : ": ", facts.estimate_text);
  const bool force = !(facts.misfit_force <= validity.misfit_max);
  const bool velocity = !(facts.misfit_velocity <= validity.misfit_max);
  if (force || velocity)
    return fmt::format(
        "The brake model does not explain the measured {}: the misfit is {:.1f} times what sensor noise "
        "explains ({:.3g} allowed).",
        force ? "force" : "velocity", force ? facts.misfit_force : facts.misfit_velocity,
        validity.misfit_max);
  return {};
}

}  // namespace

ParameterVerdict judge_parameter(double value, double sd, const LimitInterval& limits, double guard_band_k) {
  const double guard = guard_band_k * sd;
  const double margin = std::min(value - limits.lower, limits.upper - value);  // negative outside
  if (margin > guard) return ParameterVerdict::Pass;
  if (margin < -guard) return ParameterVerdict::Fail;
  return ParameterVerdict::Marginal;
}

Judgement judge(const CheckFacts& facts, const LimitSet& limits, const ValiditySettings& validity) {
  Judgement judgement;
  if (facts.estimated && facts.estimate.allFinite() && facts.sd.allFinite()) {
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const auto k = static_cast<Eigen::Index>(i);
      const ParameterInfo& info = kParameterTable[i];
      const LimitInterval& interval = limits.intervals[i];
      judgement.parameters.push_back(
          {std::string(info.name), std::string(info.unit), facts.estimate[k], facts.sd[k], interval.lower,
           interval.upper, judge_parameter(facts.estimate[k], facts.sd[k], interval, limits.guard_band_k)});
    }
  }
  const auto decide = [&](Verdict verdict, bool marginal, std::string reason) {
    judgement.verdict = verdict;
    judgement.marginal = marginal;
    judgement.reason = std::move(reason);
    return judgement;
  };

  if (facts.fault != FaultCause::None)
    return decide(facts.fault_verdict, false,
                  facts.fault_text.empty()
                      ? fmt::format("The station stopped the check: {}.", to_string(facts.fault))
                      : facts.fault_text);
  if (facts.deadline_passed)
    return decide(Verdict::Timeout, false, "The check did not end before its deadline.");
  if (std::string why = invalidity(facts, validity); !why.empty())
    return decide(Verdict::Error, false, std::move(why));

  const auto fails = [](const ParameterRecord& p) { return p.verdict == ParameterVerdict::Fail; };
  const auto is_marginal = [](const ParameterRecord& p) { return p.verdict == ParameterVerdict::Marginal; };
  const auto undecidable = [&](const ParameterRecord& p) {
    return is_marginal(p) && 2.0 * limits.guard_band_k * p.sd >= p.upper - p.lower;
  };
  const auto marginal_outside = [&](const ParameterRecord& p) { return is_marginal(p) && !is_inside(p); };
  const auto any = [&](auto predicate) {
    return std::any_of(judgement.parameters.begin(), judgement.parameters.end(), predicate);
  };

  if (any(fails)) return decide(Verdict::Fail, false, describe_all(judgement.parameters, fails) + ".");
  if (any(undecidable)) {
    const ParameterRecord& worst =
        *std::find_if(judgement.parameters.begin(), judgement.parameters.end(), undecidable);
    return decide(Verdict::Error, false,
                  fmt::format("{} is too uncertain to be judged (± {:.2g} {}): more repeats, or less noise.",
                              worst.name, worst.sd, worst.unit));
  }
  if (any(marginal_outside))
    return decide(Verdict::Fail, true,
                  describe_all(judgement.parameters, marginal_outside) + ", by less than its uncertainty.");
  if (!(facts.tracking_rms_N <= validity.tracking_rms_max_N))
    return decide(Verdict::Error, false,
                  fmt::format("The brake did not follow the trajectory: {:.0f} N rms off ({:.0f} N allowed).",
                              facts.tracking_rms_N, validity.tracking_rms_max_N));
  if (any(is_marginal))
    return decide(Verdict::Pass, true,
                  describe_all(judgement.parameters, is_marginal) + ", by less than its uncertainty.");
  return decide(Verdict::Pass, false, "All seven parameters are within their limits.");
}

int exit_code(Verdict verdict) {
  switch (verdict) {
    case Verdict::Pass:
      return 0;
    case Verdict::Fail:
      return 1;
    case Verdict::Error:
      return 3;
    case Verdict::Aborted:
      return 4;
    case Verdict::Timeout:
      return 5;
  }
  return 3;
}

}  // namespace clampd
