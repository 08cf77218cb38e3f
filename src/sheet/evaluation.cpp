#include "clampd/sheet/evaluation.hpp"

#include <cmath>
#include <limits>
#include <optional>

#include <fmt/format.h>

#include "clampd/statistics/symmetric.hpp"
#include "src/sheet/measured_brake.hpp"

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

/// By how much each of theta / theta_nom and of the effects' parameters, in their unit, may change so that it
/// matters.
Eigen::VectorXd changes_that_matter(const Posterior& posterior) {
  std::vector<double> changes(kParameterCount, 1.0);
  for (const EffectValues& effect : posterior.effects)
    for (const EffectParameter& parameter : info_of(*effect.effect).parameters)
      changes.push_back(parameter.scale);
  return Eigen::Map<const Eigen::VectorXd>(changes.data(), static_cast<Eigen::Index>(changes.size()));
}

/// One standard deviation along each principal axis of what the kind needs, and of all effects, a column
/// each, in SI.
Eigen::MatrixXd deviations(const CharacteristicKind& kind, const Posterior& posterior) {
  constexpr auto kBase = static_cast<Eigen::Index>(kParameterCount);
  Eigen::VectorXd unit = changes_that_matter(posterior);
  std::vector<Eigen::Index> needed;
  for (const Parameter parameter : kind.needs) needed.push_back(static_cast<Eigen::Index>(parameter));
  for (Eigen::Index i = kBase; i < unit.size(); ++i) needed.push_back(i);
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(unit.size(), unit.size());
  if (posterior.effects.empty())
    covariance(needed, needed) = posterior.covariance_normalised(needed, needed);
  else
    covariance(needed, needed) =
        posterior.covariance_with_effects.cwiseQuotient(unit * unit.transpose())(needed, needed);
  unit.head<kBase>() = nominal_parameters();
  const statistics::Spectrum spectrum = statistics::spectrum_of(covariance);
  return unit.asDiagonal() * spectrum.vectors * spectrum.values.cwiseMax(0.0).cwiseSqrt().asDiagonal();
}

/// The brake, with every parameter moved by this much.
ExtendedParameters moved_by(ExtendedParameters brake, const Eigen::VectorXd& change) {
  brake.base.theta += change.head<static_cast<int>(kParameterCount)>();
  auto next = static_cast<Eigen::Index>(kParameterCount);
  for (EffectValues& effect : brake.effects)
    for (double& value : effect.values) value += change[next++];
  return brake;
}

std::optional<double> value_of(const Characteristic& line, const ExtendedParameters& brake,
                               const NominalDrive& drive) {
  if (brake.effects.empty()) return line.kind->value(brake.base, line.circumstances, drive);
  return line.kind->measured(MeasuredBrake(brake), line.circumstances, drive);
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
  ExtendedParameters centre{{nominal_parameters(), posterior.parameters.fixed}, posterior.effects};
  for (const Parameter parameter : kind.needs)
    centre.base.theta[static_cast<Eigen::Index>(parameter)] =
        posterior.parameters.theta[static_cast<Eigen::Index>(parameter)];
  const std::optional<double> value = value_of(line, centre, drive);
  double variance = 0.0;
  int reached = value ? 1 : 0, tried = 1;
  const Eigen::MatrixXd axes = deviations(kind, posterior);
  for (const auto& deviation : axes.colwise()) {
    if (deviation.isZero(0.0)) continue;
    std::optional<double> sides[2];
    for (const int side : {0, 1}) {
      const ExtendedParameters brake = moved_by(centre, (side == 0 ? 1.0 : -1.0) * deviation);
      if (const ParameterInfo* info = meaningless(brake.base.theta))
        return no_number(State::Unknown, fmt::format("{} is too uncertain", info->name));
      sides[side] = value_of(line, brake, drive);
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

namespace {

constexpr const char* kVagueModel = "these runs do not determine all of the model's parameters";

/// Those of the estimate's effects that change the brake, and where their parameters stand among all.
std::vector<EffectValues> effects_that_count(const Estimate& estimate, std::vector<Eigen::Index>& places) {
  std::vector<EffectValues> counted;
  for (std::size_t at = 0; at < estimate.effects.size();) {
    const Effect* effect = find_effect(estimate.effects[at].effect);
    const EffectInfo& info = info_of(*effect);
    EffectValues values{effect, {}};
    for (std::size_t i = 0; i < info.parameters.size(); ++i, ++at) {
      values.values.push_back(estimate.effects[at].value);
      if (changes_brake(info)) places.push_back(static_cast<Eigen::Index>(kParameterCount + at));
    }
    if (changes_brake(info)) counted.push_back(std::move(values));
  }
  return counted;
}

/// What a tare does to theta / theta_nom and to the effects' parameters.
Eigen::MatrixXd tare_covariance(const Estimate& estimate, const Eigen::Vector2d& tare_sd) {
  Eigen::MatrixXd sensitivity(estimate.covariance_with_effects.rows(), 2);
  sensitivity.topRows<static_cast<int>(kParameterCount)>() = estimate.offset_sensitivity;
  for (std::size_t at = 0; at < estimate.effects.size(); ++at)
    sensitivity.row(static_cast<Eigen::Index>(kParameterCount + at)) =
        Eigen::RowVector2d(estimate.effects[at].offset_sensitivity.data());
  return sensitivity * tare_sd.cwiseAbs2().asDiagonal() * sensitivity.transpose();
}

}  // namespace

Posterior posterior_of(const Estimate& estimate, const ParameterMatrix& added_normalised,
                       const Eigen::Vector2d& tare_sd) {
  Posterior posterior;
  posterior.parameters = estimate.parameters;
  posterior.covariance_normalised = estimate.covariance_normalised + added_normalised;
  if (!estimate.converged() && estimate.termination != Termination::NotIdentifiable)
    posterior.unknown = "there is no estimate: " + estimate.message;
  if (estimate.effects.empty() || !posterior.unknown.empty()) return posterior;
  std::vector<Eigen::Index> places;
  for (Eigen::Index i = 0; i < static_cast<Eigen::Index>(kParameterCount); ++i) places.push_back(i);
  posterior.effects = effects_that_count(estimate, places);
  if (const Result<void> countable = check_countable(posterior.effects); !countable)
    posterior.unknown = countable.error().message;
  else if (!posterior.effects.empty() && estimate.covariance_with_effects.size() == 0)
    posterior.unknown = kVagueModel;
  if (posterior.effects.empty() || !posterior.unknown.empty()) return posterior;
  const Eigen::MatrixXd with_tare = estimate.covariance_with_effects + tare_covariance(estimate, tare_sd);
  posterior.covariance_with_effects = with_tare(places, places);
  if (!posterior.covariance_with_effects.allFinite()) posterior.unknown = kVagueModel;
  posterior.covariance_with_effects
      .topLeftCorner<static_cast<int>(kParameterCount), static_cast<int>(kParameterCount)>() =
      posterior.covariance_normalised;
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
