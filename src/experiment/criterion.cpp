#include "clampd/experiment/criterion.hpp"

#include <cmath>
#include <limits>

#include "clampd/identify/information.hpp"

namespace clampd {

namespace {

constexpr double kNoInformation = std::numeric_limits<double>::infinity();

}  // namespace

std::string_view to_string(Objective objective) noexcept {
  return objective == Objective::D ? "d" : "a";
}

std::optional<Objective> parse_objective(std::string_view name) noexcept {
  for (const Objective objective : {Objective::D, Objective::A})
    if (name == to_string(objective)) return objective;
  return std::nullopt;
}

Criterion criterion_of(const ParameterMatrix& information) noexcept {
  const Criterion criterion{-log_det(information), cramer_rao(information).trace()};
  if (!std::isfinite(criterion.logdet) || !std::isfinite(criterion.trace_inverse))
    return {kNoInformation, kNoInformation};
  return criterion;
}

ObjectivePoint evaluate(Objective objective, const ParameterMatrix& information) noexcept {
  const double logdet = -log_det(information);
  const ParameterMatrix inverse = cramer_rao(information);
  if (!std::isfinite(logdet) || !inverse.allFinite()) return {kNoInformation, ParameterMatrix::Zero()};
  if (objective == Objective::D) return {logdet, -inverse};
  const double trace = inverse.trace();
  return {std::log(trace), -inverse * inverse / trace};
}

}  // namespace clampd
