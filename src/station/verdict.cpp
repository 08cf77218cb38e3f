#include "clampd/station/verdict.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

namespace clampd {
namespace {

/// A parameter with what it is judged by: its limits, less those that no value can be beyond.
struct Judged {
  ParameterRecord record;
  LimitInterval limits;
  double guard_band_k;
};

bool is_inside(const Judged& parameter) {
  return parameter.record.value >= parameter.limits.lower && parameter.record.value <= parameter.limits.upper;
}

std::string describe(const Judged& parameter) {
  const auto& [record, limits, guard_band_k] = parameter;
  if (std::isnan(record.value)) return fmt::format("{} is not reached", record.name);
  const bool low = record.value - limits.lower < limits.upper - record.value;
  return fmt::format("{} is {:.4g} {}, {} its {} limit {:.4g} {}", record.name, record.value, record.unit,
                     is_inside(parameter) ? "close to" : (low ? "below" : "above"), low ? "lower" : "upper",
                     low ? record.lower : record.upper, record.unit);
}

template <class Predicate>
std::string describe_all(const std::vector<Judged>& parameters, Predicate wanted) {
  std::string text;
  for (const Judged& parameter : parameters) {
    if (!wanted(parameter)) continue;
    if (!text.empty()) text += "; ";
    text += describe(parameter);
  }
  return text;
}

Judged judged(std::string name, std::string unit, double value, double sd, const LimitInterval& given,
              const LimitInterval& decisive, double guard_band_k) {
  return {{std::move(name), std::move(unit), value, sd, given.lower, given.upper,
           judge_parameter(value, sd, decisive, guard_band_k)},
          decisive,
          guard_band_k};
}

const EffectEstimate* find_estimate(const CheckFacts& facts, const EffectLimit& limit) {
  const auto found = std::find_if(facts.effects.begin(), facts.effects.end(), [&](const auto& estimate) {
    return estimate.effect == limit.effect && estimate.parameter == limit.parameter;
  });
  return found == facts.effects.end() ? nullptr : &*found;
}

bool is_known(const EffectEstimate* estimate) {
  return estimate != nullptr && std::isfinite(estimate->value) && estimate->sd >= 0.0;
}

LimitInterval decisive_limits(const EffectLimit& limit) {
  LimitInterval decisive = limit.interval;
  for (const EffectParameter& parameter : info_of(*find_effect(limit.effect)).parameters) {
    if (parameter.name != limit.parameter) continue;
    constexpr double kUnlimited = std::numeric_limits<double>::infinity();
    if (decisive.lower <= parameter.lower) decisive.lower = -kUnlimited;
    if (decisive.upper >= parameter.upper) decisive.upper = kUnlimited;
  }
  return decisive;
}

GuardBands guard_bands(const CheckFacts& facts, const LimitSet& limits) {
  return facts.guard_bands.value_or(
      GuardBands{ParameterVector::Constant(limits.guard_band_k), limits.guard_band_k});
}

std::vector<Judged> judge_parameters(const CheckFacts& facts, const LimitSet& limits) {
  std::vector<Judged> parameters;
  if (!facts.estimated || !facts.estimate.allFinite() || !facts.sd.allFinite()) return parameters;
  const GuardBands bands = guard_bands(facts, limits);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    const ParameterInfo& info = kParameterTable[i];
    parameters.push_back(judged(std::string(info.name), std::string(info.unit), facts.estimate[k],
                                facts.sd[k], limits.intervals[i], limits.intervals[i], bands.parameters[k]));
  }
  for (const EffectLimit& limit : limits.effects)
    if (const EffectEstimate* estimate = find_estimate(facts, limit); is_known(estimate))
      parameters.push_back(judged(limit.effect + "." + limit.parameter, estimate->unit, estimate->value,
                                  estimate->sd, limit.interval, decisive_limits(limit), bands.effects));
  return parameters;
}

/// Those lines of the sheet that a verdict depends on.
void add_sheet(const CheckFacts& facts, double guard_band_k, std::vector<Judged>& parameters) {
  for (const CharacteristicRecord& line : facts.characteristics)
    if (line.verdict)
      parameters.push_back(
          {{line.name, line.unit, line.value, line.sd, line.lower, line.upper, *line.verdict},
           {line.lower, line.upper},
           guard_band_k});
}

/// Why nothing can be said about the brake; empty if something can.
std::string invalidity(const CheckFacts& facts, const LimitSet& limits, const ValiditySettings& validity,
                       bool& unexplained) {
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
  unexplained = facts.unexplained;
  if (!facts.estimated || !facts.estimate.allFinite() || !facts.sd.allFinite() ||
      (facts.sd.array() < 0.0).any())
    return fmt::format("No parameters could be identified from the runs{}{}.",
                       facts.estimate_text.empty() ? "" : ": ", facts.estimate_text);
  for (const EffectLimit& limit : limits.effects)
    if (!is_known(find_estimate(facts, limit)))
      return fmt::format("{}.{} could not be identified from the runs, so that it cannot be judged.",
                         limit.effect, limit.parameter);
  for (const CharacteristicRecord& line : facts.characteristics)
    if (line.has_limits() && !line.verdict)
      return fmt::format("{} is not known, so that it cannot be judged: {}.", line.name, line.why);
  unexplained = !facts.other_method.empty();
  if (unexplained) return facts.other_method;
  const bool force = !(facts.misfit_force <= validity.misfit_max);
  const bool velocity = !(facts.misfit_velocity <= validity.misfit_max);
  unexplained = force || velocity;
  if (unexplained)
    return fmt::format(
        "The brake model does not explain the measured {}: the misfit is {:.1f} times what sensor noise "
        "explains ({:.3g} allowed).",
        force ? "force" : "velocity", force ? facts.misfit_force : facts.misfit_velocity,
        validity.misfit_max);
  return {};
}

std::string all_within(std::size_t parameters, std::size_t judged) {
  const std::string count = parameters == kParameterCount ? "seven" : std::to_string(parameters);
  const std::string sheet =
      judged == parameters ? "" : fmt::format(" and {} of the sheet", judged - parameters);
  return fmt::format("All {} parameters{} are within their limits.", count, sheet);
}

}  // namespace

ParameterVerdict judge_parameter(double value, double sd, const LimitInterval& limits, double guard_band_k) {
  const double guard = guard_band_k * sd;
  const double margin = std::min(value - limits.lower, limits.upper - value);  // negative outside
  if (margin > guard) return ParameterVerdict::Pass;
  if (margin < -guard) return ParameterVerdict::Fail;
  return ParameterVerdict::Marginal;
}

std::vector<CharacteristicRecord> judge_sheet(const std::vector<Characteristic>& characteristics,
                                              const std::vector<CharacteristicEstimate>& estimates,
                                              double guard_band_k) {
  using State = CharacteristicEstimate::State;
  std::vector<CharacteristicRecord> lines;
  for (std::size_t i = 0; i < characteristics.size(); ++i) {
    const auto& [name, kind, circumstances, lower, upper] = characteristics[i];
    const CharacteristicEstimate& estimate = estimates[i];
    CharacteristicRecord line{
        name, std::string(kind->name), std::string(kind->unit), estimate.value, estimate.sd, lower, upper};
    line.why = estimate.why;
    line.circumstances = circumstances_text(characteristics[i]);
    if (characteristics[i].has_limits() && estimate.state != State::Unknown)
      line.verdict = estimate.state == State::NotReached
                         ? ParameterVerdict::Fail
                         : judge_parameter(estimate.value, estimate.sd, {lower, upper}, guard_band_k);
    lines.push_back(std::move(line));
  }
  return lines;
}

Judgement judge(const CheckFacts& facts, const LimitSet& limits, const ValiditySettings& validity) {
  Judgement judgement;
  std::vector<Judged> parameters = judge_parameters(facts, limits);
  for (const Judged& parameter : parameters) judgement.parameters.push_back(parameter.record);
  judgement.characteristics = facts.characteristics;
  add_sheet(facts, guard_bands(facts, limits).widest(), parameters);
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
  if (!facts.refusal.empty()) return decide(Verdict::Error, false, facts.refusal);
  if (std::string why = invalidity(facts, limits, validity, judgement.unexplained); !why.empty())
    return decide(Verdict::Error, false, std::move(why));

  const auto fails = [](const Judged& p) { return p.record.verdict == ParameterVerdict::Fail; };
  const auto is_marginal = [](const Judged& p) { return p.record.verdict == ParameterVerdict::Marginal; };
  const auto undecidable = [&](const Judged& p) {
    // Between a limit and where no value can be, there is only one guard band.
    const bool one_sided = std::isinf(p.limits.lower) || std::isinf(p.limits.upper);
    return is_marginal(p) &&
           (one_sided ? 1.0 : 2.0) * p.guard_band_k * p.record.sd >= p.record.upper - p.record.lower;
  };
  const auto marginal_outside = [&](const Judged& p) { return is_marginal(p) && !is_inside(p); };
  const auto any = [&](auto predicate) {
    return std::any_of(parameters.begin(), parameters.end(), predicate);
  };

  judgement.undecided = !any(fails) && any(is_marginal);
  if (any(fails)) return decide(Verdict::Fail, false, describe_all(parameters, fails) + ".");
  if (any(undecidable)) {
    const ParameterRecord& worst = std::find_if(parameters.begin(), parameters.end(), undecidable)->record;
    return decide(
        Verdict::Error, false,
        fmt::format("{} is too uncertain to be judged (± {:.2g} {}): {}.", worst.name, worst.sd, worst.unit,
                    facts.misfit_counts
                        ? "the model does not explain all of this brake's motion, which counts in it"
                        : "more repeats, or less noise"));
  }
  if (any(marginal_outside))
    return decide(Verdict::Fail, true,
                  describe_all(parameters, marginal_outside) + ", by less than its uncertainty.");
  if (!(facts.tracking_rms_N <= validity.tracking_rms_max_N))
    return decide(Verdict::Error, false,
                  fmt::format("The brake did not follow the trajectory: {:.0f} N rms off ({:.0f} N allowed).",
                              facts.tracking_rms_N, validity.tracking_rms_max_N));
  if (any(is_marginal))
    return decide(Verdict::Pass, true,
                  describe_all(parameters, is_marginal) + ", by less than its uncertainty.");
  return decide(Verdict::Pass, false, all_within(judgement.parameters.size(), parameters.size()));
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
