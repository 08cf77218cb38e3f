#include "clampd/record/check_record.hpp"

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
  for (const Verdict verdict :
       {Verdict::Pass, Verdict::Fail, Verdict::Error, Verdict::Timeout, Verdict::Aborted})
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

}  // namespace clampd
