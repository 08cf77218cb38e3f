#include "clampd/views/diagnosis_words.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

namespace clampd::words {
namespace {

struct Scaled {
  std::string_view unit;
  double factor;
};

struct Prefix {
  std::string_view unit;
  double below;  ///< of this size in the unit
  Scaled scaled;
};

/// The first that fits is taken.
constexpr std::array<Prefix, 6> kPrefixes{{
    {"s", 1e-4, {"µs", 1e6}},
    {"s", 1.0, {"ms", 1e3}},
    {"N m", 0.1, {"mN m", 1e3}},
    {"rad", 0.1, {"mrad", 1e3}},
    {"m", 0.1, {"mm", 1e3}},
    {"kg m^2", 0.1, {"g m^2", 1e3}},
}};

std::string typographic(std::string unit) {
  if (unit == "1/rev") return "per revolution";
  if (unit.starts_with("1/")) unit.replace(0, 2, "per ");
  for (const auto& [plain, raised] : {std::pair<std::string_view, std::string_view>{"^2", "²"}, {"^3", "³"}})
    for (std::size_t at = 0; (at = unit.find(plain, at)) != std::string::npos;)
      unit.replace(at, plain.size(), raised);
  return unit;
}

Scaled readable(const EstimatedParameter& parameter) {
  for (const Prefix& prefix : kPrefixes)
    if (prefix.unit == parameter.unit && parameter.value != 0.0 && std::abs(parameter.value) < prefix.below)
      return prefix.scaled;
  return {parameter.unit, 1.0};
}

bool shown(double before, double after) {
  const auto says_something = [](double value) { return std::isfinite(value) && value != 0.0; };
  return says_something(before) || says_something(after);
}

/// "1,234,000": groups of three digits.
std::string grouped(double number) {
  std::string text = fmt::format("{:.0f}", number);
  for (std::size_t at = text.size(); at > 3;) text.insert(at -= 3, ",");
  return text;
}

}  // namespace

std::string with_sd(double value, double sd) {
  if (!std::isfinite(value)) return "-";
  if (!std::isfinite(sd) || sd <= 0.0) return fmt::format("{:.4g}", value);
  const double magnitude = std::max(std::abs(value), sd);
  if (magnitude < 1e-3 || magnitude >= 1e6) {
    const int digits = std::clamp(
        static_cast<int>(std::floor(std::log10(magnitude)) - std::floor(std::log10(sd))) + 1, 1, 8);
    return fmt::format("{:.{}e} ± {:.1e}", value, digits, sd);
  }
  const int decimals = std::clamp(1 - static_cast<int>(std::floor(std::log10(sd))), 0, 9);
  return fmt::format("{:.{}f} ± {:.{}f}", value, decimals, sd, decimals);
}

std::string estimate(const EstimatedParameter& parameter) {
  return std::isfinite(parameter.value) ? with_sd(parameter.value, parameter.sd) : "not identifiable";
}

std::string quantity(const EstimatedParameter& parameter) {
  if (!parameter.choice.empty()) return parameter.choice;
  const Scaled scale = readable(parameter);
  const std::string number = with_sd(parameter.value * scale.factor, parameter.sd * scale.factor);
  return parameter.unit.empty() || parameter.unit == "1"
             ? number
             : fmt::format("{} {}", number, typographic(std::string(scale.unit)));
}

std::string meaning(const std::string& effect, const std::string& parameter) {
  if (const Effect* const known = find_effect(effect))
    for (const EffectParameter& described : info_of(*known).parameters)
      if (described.name == parameter) return std::string(described.description);
  return "";
}

std::string quantities(std::span<const EstimatedParameter> parameters) {
  std::string text;
  for (const EstimatedParameter& parameter : parameters)
    text += fmt::format("{}{} {}", text.empty() ? "" : ", ", parameter.name, quantity(parameter));
  return text;
}

std::string chance(double p_value) {
  if (!std::isfinite(p_value)) return "-";
  if (p_value < 1e-6) return "less than 1 in a million";
  if (p_value >= 0.01) return fmt::format("{:.2g} %", 100.0 * p_value);
  const double odds = 1.0 / p_value;
  const double unit = std::pow(10.0, std::floor(std::log10(odds)) - 1.0);
  return "1 in " + grouped(std::round(odds / unit) * unit);
}

std::string enumeration(std::span<const std::string> items, std::string_view last_word) {
  std::string text;
  for (std::size_t i = 0; i < items.size(); ++i) {
    if (i > 0) text += i + 1 == items.size() ? fmt::format(" {} ", last_word) : ", ";
    text += items[i];
  }
  return text;
}

std::string place(Location location, std::string_view torque) {
  switch (location) {
    case Location::TorqueBalance:
      return fmt::format("the {} balance", torque);
    case Location::Stiffness:
      return "the stiffness";
    case Location::ForceReading:
      return "the reading of clamp force";
    case Location::VelocityReading:
      return "the reading of velocity";
    case Location::TorqueReading:
      return fmt::format("the reading of {}", torque);
    case Location::Timing:
      return "the timing of the readings";
  }
  return "";
}

std::string meaning(Location location, std::string_view torque) {
  switch (location) {
    case Location::TorqueBalance:
      return fmt::format(
          "Another {} acts on the motor than the model's: friction, inertia or something unknown.", torque);
    case Location::Stiffness:
      return "The brake answers a position with another clamp force than the model's.";
    case Location::ForceReading:
      return "The clamp force is not what its sensor says.";
    case Location::VelocityReading:
      return "The velocity is not what its sensor says.";
    case Location::TorqueReading:
      return fmt::format("The {} that acts is not the one that was recorded.", torque);
    case Location::Timing:
      return "The readings do not belong to the instant that they are recorded for.";
  }
  return "";
}

std::string variable(std::string_view name, std::string_view torque) {
  if (name == "position") return "the motor's position";
  if (name == "velocity") return "the velocity";
  if (name == "force") return "the clamp force";
  if (name == "time") return "the time within a run";
  if (name == "direction") return "the direction of motion";
  if (name == "run") return "the run: it changes from run to run";
  if (name == "torque") return fmt::format("the {}", torque);
  if (name == "rate") return "how quickly the readings change";
  if (name == kRepetition) return "whether a reading only repeats the last one: it was held";
  return std::string(name);
}

std::vector<std::string> depends_on(const Misfit& misfit) {
  std::vector<std::string> names;
  for (const Dependence& dependence : misfit.dependences)
    if (dependence.p_value < kSignificant &&
        std::find(names.begin(), names.end(), dependence.variable) == names.end())
      names.push_back(dependence.variable);
  return names;
}

std::string cause(const std::string& effect) {
  const Effect* const known = find_effect(effect);
  return known == nullptr ? "" : std::string(info_of(*known).cause);
}

std::string cause(const NamedEffect& effect) {
  return effect.words.empty() ? cause(effect.name) : effect.words;
}

bool explains(const Diagnosis& diagnosis) {
  return diagnosis.verdict != DiagnosisVerdict::Unexplained;
}

std::string_view role(const Diagnosis& diagnosis) {
  return explains(diagnosis) ? "Cause" : "Tried, and not enough";
}

bool has_rivals(const Diagnosis& diagnosis, const std::string& effect) {
  return diagnosis.verdict == DiagnosisVerdict::Ambiguous &&
         std::any_of(diagnosis.rivals.begin(), diagnosis.rivals.end(),
                     [&](const std::vector<std::string>& group) {
                       return std::find(group.begin(), group.end(), effect) != group.end();
                     });
}

std::string headline(const Diagnosis& diagnosis, std::string_view torque) {
  std::vector<std::string> causes;
  for (const NamedEffect& effect : diagnosis.effects) {
    const bool is_said = std::find(causes.begin(), causes.end(), effect.name) != causes.end();  // a harmonic
    if (!is_said && !has_rivals(diagnosis, effect.name)) causes.push_back(effect.name);
  }
  switch (diagnosis.verdict) {
    case DiagnosisVerdict::Adequate:
      return "the model explains the runs";
    case DiagnosisVerdict::Explained:
      return fmt::format("the cause is {}", enumeration(causes, "and"));
    case DiagnosisVerdict::Ambiguous:
      for (const std::vector<std::string>& group : diagnosis.rivals)
        causes.push_back(enumeration(group, "or"));
      return fmt::format("the cause is {}", enumeration(causes, "and"));
    case DiagnosisVerdict::Unexplained:
      return diagnosis.misfit.location
                 ? fmt::format("an unknown cause in {}", place(*diagnosis.misfit.location, torque))
                 : "an unknown cause";
  }
  return "";
}

bool has_gain(const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  return diagnosis.gain && (subject.drive || !diagnosis.gain->runs.empty());
}

std::string how_to_record(const NextExperiment& experiment) {
  if (is_driven(experiment.trajectory)) return "";
  return "nothing is to be driven: record the readings with the drive off, in a run file with the column "
         "drive_enabled, 0 in every row";
}

std::string heldout_runs(const HeldOutGain& gain) {
  const std::size_t runs = gain.runs.size();
  if (runs == 0) return "parts of the runs that the model was not fitted to";
  return fmt::format("{} run{} that the model was not fitted to", runs, runs == 1 ? "" : "s");
}

std::vector<GainRow> gain_rows(const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  std::vector<GainRow> rows;
  if (!has_gain(diagnosis, subject)) return rows;
  const GainFigures& before = diagnosis.gain->before;
  const GainFigures& after = diagnosis.gain->after;
  const auto add = [&](const std::string& what, double GainFigures::*figure, const auto& text,
                       bool less_is_better) {
    if (!shown(before.*figure, after.*figure)) return;
    const bool better = less_is_better ? after.*figure < before.*figure : after.*figure > before.*figure;
    rows.push_back({what, text(before.*figure), text(after.*figure), better});
  };
  const auto decimals = [](int count) {
    return [count](double value) {
      return std::isfinite(value) ? fmt::format("{:.{}f}", value, count) : std::string("-");
    };
  };
  // Drives are of any size: digits that count, not decimals.
  const auto digits = [](double value) { return std::isfinite(value) ? fmt::format("{:.3g}", value) : std::string("-"); };
  add("force, one sample ahead (N rms)", &GainFigures::rms_force_N, decimals(1), true);
  add("velocity, one sample ahead (rad/s rms)", &GainFigures::rms_velocity_rad_s, decimals(3), true);
  add("force, simulated with the torque errors (N rms)", &GainFigures::simulated_rms_force_N, decimals(1),
      true);
  add("velocity, the same (rad/s rms)", &GainFigures::simulated_rms_velocity_rad_s, decimals(3), true);
  add(fmt::format("{} that the motion needs ({} rms)", subject.effort(), subject.torque_unit),
      &GainFigures::rms_torque_Nm, digits, true);
  add(fmt::format("the same, of the {}'s own rms", subject.effort()), &GainFigures::torque_error_relative, digits, true);
  add("misfit (1: the noise floor)", &GainFigures::misfit, decimals(3), true);
  add("log likelihood per sample (nats)", &GainFigures::log_likelihood_per_sample, decimals(3), false);
  add(
      "chance that what is left is white noise", &GainFigures::whiteness_p_value,
      [](double value) { return value < 1e-6 ? std::string("< 1e-6") : fmt::format("{:.2g}", value); },
      false);
  return rows;
}

std::vector<ParameterRow> parameter_rows(const Diagnosis& diagnosis) {
  std::vector<ParameterRow> rows;
  for (const EstimatedParameter& after : diagnosis.parameters_after) {
    ParameterRow row{{.name = after.name, .unit = after.unit}, after, 0.0};
    const auto same = std::find_if(diagnosis.parameters_before.begin(), diagnosis.parameters_before.end(),
                                   [&](const EstimatedParameter& other) { return other.name == after.name; });
    if (same != diagnosis.parameters_before.end()) {
      row.before = *same;
      row.is_in_base = true;
    }
    row.moved_sd = (after.value - row.before.value) / row.before.sd;
    rows.push_back(std::move(row));
  }
  return rows;
}

}  // namespace clampd::words
