#include "src/diagnose/words.hpp"

#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace clampd::diagnosing {

namespace {

std::string words_of(const NamedEffect& named) {
  EffectValues values{find_effect(named.name), {}};
  std::vector<double> sds;
  for (const EstimatedParameter& parameter : named.parameters) {
    values.values.push_back(parameter.value);
    sds.push_back(parameter.sd);
  }
  // Beyond the effect's own parameters: the amplitude of its free states.
  const std::size_t own = info_of(*values.effect).parameters.size();
  return in_words(values, sds, named.parameters.size() > own ? named.parameters[own].value : NAN);
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
      smallest = fmt::format("below {} it could not have been seen", size_in_words(7.0 * blindness * parameter.scale, parameter.unit));
      break;
    }
  return fmt::format("{}: it shows in {}", smallest, info.excitation);
}

}  // namespace clampd::diagnosing
