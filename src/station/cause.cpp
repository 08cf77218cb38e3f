#include "clampd/station/cause.hpp"

namespace clampd {

std::optional<CauseRecord> cause_of(const Diagnosis& diagnosis) {
  if (diagnosis.verdict == DiagnosisVerdict::Adequate) return std::nullopt;
  CauseRecord cause;
  cause.verdict = to_string(diagnosis.verdict);
  for (const NamedEffect& effect : diagnosis.effects) cause.effects.push_back(effect.name);
  if (!diagnosis.effects.empty())
    cause.location = to_string(diagnosis.effects.front().location);
  else if (diagnosis.misfit.location)
    cause.location = to_string(*diagnosis.misfit.location);
  cause.rivals = diagnosis.rivals;
  cause.summary = diagnosis.summary;
  return cause;
}

}  // namespace clampd
