#include "clampd/sheet/evaluation.hpp"

#include <cmath>
#include <limits>
#include <optional>

#include <fmt/format.h>

#include "clampd/statistics/symmetric.hpp"

namespace clampd {
namespace {

using State = CharacteristicEstimate::State;

CharacteristicEstimate no_number(State state, std::string why) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  return {state, kNaN, kNaN, std::move(why)};
}

/// Why one of the needed parameters is not known; empty if all are. A parameter that was held has no
/// variance: runs say nothing about it.
std::string missing(const CharacteristicKind& kind, const Posterior& posterior) {
  std::string why;
  for (const Parameter parameter : kind.needs) {
    const auto i = static_cast<Eigen::Index>(parameter);
    const double variance = posterior.covariance_normalised(i, i);
    const std::string_view name = kParameterTable[parameter].name;
    if (!std::isfinite(posterior.parameters.theta[i]))
      return fmt::format("it needs {}, which these runs do not determine", name);
    if (variance == 0.0 && why.empty())
      why = fmt::format("it needs {}, which was held and not identified", name);
    if (!std::isfinite(variance) && why.empty())
      why = fmt::format(
          "it needs {}, whose uncertainty is not known while other parameters are not identifiable: hold "
          "those",
          name);
  }
  return why;
}

/// One standard deviation along each principal axis of what the kind needs, a column each, in SI.
Eigen::MatrixXd deviations(const CharacteristicKind& kind, const Posterior& posterior) {
  ParameterMatrix covariance = ParameterMatrix::Zero();
  for (const Parameter row : kind.needs)
    for (const Parameter column : kind.needs)
      covariance(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(column)) =
          posterior.covariance_normalised(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(column));
  const statistics::Spectrum spectrum = statistics::spectrum_of(covariance);
  return nominal_parameters().asDiagonal() * spectrum.vectors *
         spectrum.values.cwiseMax(0.0).cwiseSqrt().asDiagonal();
}

/// The first parameter without which the equations have no meaning, if it is not above zero. The others act
/// in proportion to themselves, so that a deviation may carry them beyond zero.
const ParameterInfo* meaningless(const ParameterVector& theta) {
  for (const Parameter parameter : {k2, ws})
    if (const ParameterInfo& info = kParameterTable[parameter];
        !(theta[static_cast<Eigen::Index>(parameter)] >= info.lower))
      return &info;
  return nullptr;
}

/// What the encoder tells.
CharacteristicEstimate evaluate_contact(const CharacteristicKind& kind, const Posterior& posterior) {
  const ContactPoint& contact = posterior.contact;
  if (!contact.why.empty()) return no_number(State::Unknown, contact.why);
  if (kind.from_where_found && !posterior.found_rad)
    return no_number(
        State::Unknown,
        "where the check found the brake is not on record: let a station check it, since run files and "
        "checks of earlier versions do not say, or leave this line out");
  double value = contact.position_rad;
  double variance = contact.by_parameters.dot(posterior.covariance_normalised * contact.by_parameters +
                                              2.0 * posterior.covariance_with_contact) +
                    contact.variance_rad2;
  if (kind.from_where_found) {
    value -= *posterior.found_rad;
    variance += contact.reading_sd_rad * contact.reading_sd_rad;
  }
  return {State::Known, value, std::sqrt(variance), {}};
}

CharacteristicEstimate evaluate_one(const Characteristic& line, const Posterior& posterior,
                                    const NominalDrive& drive) {
  const CharacteristicKind& kind = *line.kind;
  if (std::string why = missing(kind, posterior); !why.empty())
    return no_number(State::Unknown, std::move(why));
  if (kind.value == nullptr) return evaluate_contact(kind, posterior);
  // What the kind does not need may be unknown: any value does.
  BrakeParameters centre{nominal_parameters(), posterior.parameters.fixed};
  for (const Parameter parameter : kind.needs)
    centre.theta[static_cast<Eigen::Index>(parameter)] =
        posterior.parameters.theta[static_cast<Eigen::Index>(parameter)];
  const std::optional<double> value = kind.value(centre, line.circumstances, drive);
  double variance = 0.0;
  int reached = value ? 1 : 0, tried = 1;
  const Eigen::MatrixXd axes = deviations(kind, posterior);
  for (const auto& deviation : axes.colwise()) {
    if (deviation.isZero(0.0)) continue;
    std::optional<double> sides[2];
    for (const int side : {0, 1}) {
      BrakeParameters brake = centre;
      brake.theta += (side == 0 ? 1.0 : -1.0) * deviation;
      if (const ParameterInfo* info = meaningless(brake.theta))
        return no_number(State::Unknown, fmt::format("{} is too uncertain", info->name));
      sides[side] = kind.value(brake, line.circumstances, drive);
      ++tried;
      reached += sides[side] ? 1 : 0;
    }
    if (!value || !sides[0] || !sides[1]) continue;
    const double slope = 0.5 * (*sides[0] - *sides[1]);
    const double bend = 0.5 * (*sides[0] + *sides[1]) - *value;
    variance += slope * slope + 2.0 * bend * bend;
  }
  if (reached == 0) return no_number(State::NotReached, "this brake does not get there");
  if (reached < tried) return no_number(State::Unknown, "whether this brake gets there is uncertain");
  return {State::Known, *value, std::sqrt(variance), {}};
}

}  // namespace

Posterior posterior_of(const Estimate& estimate, const ParameterMatrix& added_normalised) {
  Posterior posterior;
  posterior.parameters = estimate.parameters;
  posterior.covariance_normalised = estimate.covariance_normalised + added_normalised;
  if (!estimate.effects.empty())
    posterior.unknown = "the model has effects that the sheet does not count";
  else if (!estimate.converged() && estimate.termination != Termination::NotIdentifiable)
    posterior.unknown = "there is no estimate: " + estimate.message;
  return posterior;
}

std::vector<CharacteristicEstimate> evaluate(std::span<const Characteristic> characteristics,
                                             const Posterior& posterior, const NominalDrive& drive) {
  std::vector<CharacteristicEstimate> estimates;
  for (const Characteristic& line : characteristics)
    estimates.push_back(posterior.unknown.empty() ? evaluate_one(line, posterior, drive)
                                                  : no_number(State::Unknown, posterior.unknown));
  return estimates;
}

}  // namespace clampd
