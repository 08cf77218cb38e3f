#include "src/diagnose/words.hpp"

#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace clampd::diagnosing {

namespace {

/// Values with a size that people can read: seconds as milliseconds, shares as per cent, small angles as
/// milliradians.
std::string size_of(const EstimatedParameter& parameter) {
  if (parameter.unit == "s") return fmt::format("{:.2g} ms", 1e3 * parameter.value);
  if (parameter.unit == "1") return fmt::format("{:.2g} %", 100.0 * parameter.value);
  if (parameter.unit == "rad" && std::abs(parameter.value) < 0.01)
    return fmt::format("{:.3g} mrad", 1e3 * parameter.value);
  return fmt::format("{:.3g} {}", parameter.value, parameter.unit);
}

const EstimatedParameter* parameter_of(const NamedEffect& effect, std::string_view name) {
  for (const EstimatedParameter& parameter : effect.parameters)
    if (parameter.name == name) return &parameter;
  return nullptr;
}

/// Of the strengths the one that is known to be there, by its name where there are several.
std::string strength_of(const NamedEffect& effect) {
  const std::vector<EffectParameter>& table = info_of(*find_effect(effect.name)).parameters;
  const EstimatedParameter* strongest = &effect.parameters.front();
  double most = 0.0;
  int count = 0;
  for (std::size_t i = 0; i < table.size(); ++i) {
    if (table[i].role != EffectParameter::Role::Strength) continue;
    ++count;
    const EstimatedParameter& parameter = effect.parameters[i];
    const double certainty = std::abs(parameter.value - table[i].neutral) / parameter.sd;
    if (certainty > most) {
      most = certainty;
      strongest = &parameter;
    }
  }
  return count > 1 ? fmt::format("{} {}", strongest->name, size_of(*strongest)) : size_of(*strongest);
}

std::string words_of(const NamedEffect& effect) {
  const std::string cause(info_of(*find_effect(effect.name)).cause);
  if (effect.name == "channel-skew") {
    const double late = parameter_of(effect, "fraction")->value + parameter_of(effect, "whole")->value;
    return fmt::format("the reading of {} comes {:.2g} samples late", parameter_of(effect, "channel")->choice,
                       late);
  }
  if (effect.name == "cogging") {
    const double amplitude = std::hypot(effect.parameters[0].value, effect.parameters[1].value);
    return fmt::format("{}: {:.2g} N m, {:.3g} times a revolution", cause, amplitude,
                       effect.parameters[2].value);
  }
  if (effect.name == "force-lag")
    return fmt::format("the reading of clamp force comes {} late, as through a filter",
                       size_of(effect.parameters[0]));
  if (effect.name == "velocity-lag")
    return fmt::format("the reading of velocity comes {} late, as through a filter",
                       size_of(effect.parameters[0]));
  if (effect.name == "torque-lag")
    return fmt::format("the acting torque comes {} later than its reading", size_of(effect.parameters[0]));
  if (effect.name == "force-hum")
    return fmt::format("the mains hum on the reading of clamp force ({}, {})",
                       size_of(effect.parameters.back()), size_of(effect.parameters.front()));
  if (effect.name == "outliers")
    return fmt::format("single readings of {} are far off: {} of them",
                       parameter_of(effect, "channel")->choice, size_of(effect.parameters[0]));
  if (effect.name == "friction-drift")
    return fmt::format("{} ({} a run at first)", cause, strength_of(effect));
  return fmt::format("{} ({})", cause, strength_of(effect));
}

std::string capital(std::string text) {
  if (!text.empty()) text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
  return text;
}

}  // namespace

std::string summary_words(const Diagnosis& diagnosis) {
  switch (diagnosis.verdict) {
    case DiagnosisVerdict::Adequate:
      return "The model explains these runs: nothing is left but noise.";
    case DiagnosisVerdict::Explained: {
      std::vector<std::string> words;
      for (const NamedEffect& effect : diagnosis.effects) words.push_back(words_of(effect));
      return capital(fmt::format("{}.", fmt::join(words, "; and ")));
    }
    case DiagnosisVerdict::Ambiguous: {
      std::vector<std::string> certain, open;
      for (const NamedEffect& effect : diagnosis.effects) {
        const std::vector<std::string>* group = nullptr;
        for (const auto& rivals : diagnosis.rivals)
          if (rivals.front() == effect.name) group = &rivals;
        if (group == nullptr)
          certain.push_back(words_of(effect));
        else
          open.push_back(fmt::format("{} - or one of: {}", words_of(effect),
                                     fmt::join(group->begin() + 1, group->end(), ", ")));
      }
      certain.insert(certain.end(), open.begin(), open.end());
      return capital(fmt::format("{}. These runs cannot tell which.", fmt::join(certain, "; and ")));
    }
    case DiagnosisVerdict::Unexplained: {
      std::string where = "in a place that cannot be told";
      if (diagnosis.misfit.location) where = fmt::format("in the {}", to_string(*diagnosis.misfit.location));
      std::string on;
      if (!diagnosis.misfit.dependences.empty()) {
        const std::string& variable = diagnosis.misfit.dependences.front().variable;
        on = variable == kRepetition ? ", which now and then only repeats its last value"
                                     : fmt::format(", depending on {}", variable);
      }
      return fmt::format("Something is wrong {}{}, and no known effect explains it.", where, on);
    }
  }
  return "";
}

std::string unseen_words(const Effect& effect, double blindness) {
  const EffectInfo& info = info_of(effect);
  if (!std::isfinite(blindness) || blindness > 1e3)
    return fmt::format("these runs say nothing about it: it shows in {}", info.excitation);
  std::string smallest;
  for (const EffectParameter& parameter : info.parameters)
    if (parameter.role == EffectParameter::Role::Strength) {
      const EstimatedParameter least{"", std::string(parameter.unit), 7.0 * blindness * parameter.scale, NAN};
      smallest = fmt::format("below {} it could not have been seen", size_of(least));
      break;
    }
  return fmt::format("{}: it shows in {}", smallest, info.excitation);
}

}  // namespace clampd::diagnosing
