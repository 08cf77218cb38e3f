#include "clampd/record/check_record.hpp"

#include <cmath>

namespace clampd {

std::string_view to_string(Verdict verdict) noexcept {
  switch (verdict) {
    case Verdict::Pass:
      return "PASS";
    case Verdict::Fail:
      return "FAIL";
    case Verdict::Error:
      return "ERROR";
    case Verdict::Timeout:
      return "TIMEOUT";
    case Verdict::Aborted:
      return "ABORTED";
  }
  return "?";
}

std::optional<Verdict> parse_verdict(std::string_view text) noexcept {
  for (const Verdict verdict : kVerdicts)
    if (text == to_string(verdict)) return verdict;
  return std::nullopt;
}

std::string_view to_string(ParameterVerdict verdict) noexcept {
  switch (verdict) {
    case ParameterVerdict::Pass:
      return "pass";
    case ParameterVerdict::Marginal:
      return "marginal";
    case ParameterVerdict::Fail:
      return "fail";
  }
  return "?";
}

bool CharacteristicRecord::has_limits() const {
  return std::isfinite(lower) || std::isfinite(upper);
}

bool CharacteristicRecord::is_known() const {
  return std::isfinite(value) && std::isfinite(sd);
}

std::pair<double, double> interval_95(const CharacteristicRecord& line) {
  constexpr double kQuantile = 1.96;
  return {line.value - kQuantile * line.sd, line.value + kQuantile * line.sd};
}

}  // namespace clampd
