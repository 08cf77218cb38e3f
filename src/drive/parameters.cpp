#include "src/drive/parameters.hpp"

#include <cmath>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"

namespace clampd::drive {

Estimate::Estimate(const Design& design, const TorqueModel& model, const DriveModel& drive)
    : model_(model), drive_(drive), units_(drive), covariance_(design.covariance(model.fit)) {}

Eigen::Index Estimate::at(DriveTerm term) const {
  Eigen::Index first = 0;
  for (const Variant& part : model_.parts) {
    if (part.term == term && !part.columns.empty()) return first;
    first += static_cast<Eigen::Index>(part.columns.size());
  }
  return -1;
}

EstimatedParameter Estimate::combined(std::string name, std::string unit,
                                      std::initializer_list<std::pair<Eigen::Index, double>> terms,
                                      double known) const {
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(model_.fit.coefficients.size());
  for (const auto& [index, factor] : terms)
    if (index >= 0) weights[index] += factor;
  const double variance = weights.dot(covariance_ * weights);
  return {std::move(name), std::move(unit), known + weights.dot(model_.fit.coefficients),
          variance > 0.0 ? std::sqrt(variance) : kNaN};
}

std::vector<EstimatedParameter> Estimate::base_parameters() const {
  std::vector<EstimatedParameter> parameters;
  const auto add = [&](DriveTerm term, const std::string& unit) {
    if (drive_.part(term).use == PartUse::Fixed)
      parameters.push_back({std::string(name_of(term)), unit, drive_.part(term).value, kNaN});
    else if (at(term) >= 0)
      parameters.push_back(combined(std::string(name_of(term)), unit, {{at(term), 1.0}}));
  };
  add(DriveTerm::Inertia, units_.per_acceleration);
  add(DriveTerm::Viscous, units_.per_velocity);
  add(DriveTerm::Coulomb, units_.torque);
  return parameters;
}

std::vector<EstimatedParameter> Estimate::base_parameters_with(const std::vector<Variant>& parts) const {
  std::vector<EstimatedParameter> parameters = base_parameters();
  for (const Variant& part : parts)
    for (EstimatedParameter& parameter : effect_parameters(part)) {
      parameter.name = fmt::format("{}.{}", part.name, parameter.name);
      parameters.push_back(std::move(parameter));
    }
  return parameters;
}

/// Root mean square over owners (runs) of the length of pairs of coefficients.
EstimatedParameter Estimate::amplitude(std::string name, Eigen::Index first, Eigen::Index count,
                                       Eigen::Index stride, Eigen::Index owners) const {
  double square = 0.0, noise = 0.0;
  for (Eigen::Index k = 0; k < count; ++k) {
    const Eigen::Index index = first + k * stride;
    const double value = model_.fit.coefficients[index];
    square += value * value / static_cast<double>(owners);
    noise += value * value * covariance_(index, index) / static_cast<double>(owners * owners);
  }
  const double length = std::sqrt(square);
  return {std::move(name), units_.torque, length, length > 0.0 ? std::sqrt(noise) / length : kNaN};
}

std::vector<EstimatedParameter> Estimate::cogging(const Variant& variant, Eigen::Index first) const {
  std::vector<EstimatedParameter> parameters;
  int number = 0;
  for (std::size_t i = 0; i < variant.functions.size();) {
    std::size_t end = i;
    while (end < variant.functions.size() && variant.functions[end].first == variant.functions[i].first)
      ++end;
    const std::string suffix = fmt::format("-{}", ++number);
    const auto count = static_cast<Eigen::Index>(end - i);
    const Eigen::Index from = first + static_cast<Eigen::Index>(i);
    const double order =
        drive_.linear ? variant.functions[i].first / (2.0 * M_PI) : variant.functions[i].first;
    parameters.push_back({"order" + suffix, units_.order, order, kNaN});
    parameters.push_back(amplitude("amplitude" + suffix, from, count, 1, count / 2));
    if (count == 2) {
      parameters.push_back(combined("cosine" + suffix, units_.torque, {{from, 1.0}}));
      parameters.push_back(combined("sine" + suffix, units_.torque, {{from + 1, 1.0}}));
    }
    i = end;
  }
  return parameters;
}

std::vector<EstimatedParameter> Estimate::asymmetry(const Variant& variant, Eigen::Index first) const {
  using Factor = BasisFunction::Factor;
  const bool constant = variant.functions.front().factor == Factor::One;
  const bool slope = variant.functions.back().factor == Factor::Power;
  const Eigen::Index dry = constant ? first : at(DriveTerm::TorqueOffset);
  const Eigen::Index steep = slope ? first + (constant ? 1 : 0) : -1;
  const auto known = [&](DriveTerm term) {
    return drive_.part(term).use == PartUse::Fixed ? drive_.part(term).value : 0.0;
  };
  std::vector<EstimatedParameter> parameters;
  for (const double side : {1.0, -1.0}) {
    const std::string direction = side > 0.0 ? "forward" : "backward";
    parameters.push_back(combined("viscous-" + direction, units_.per_velocity,
                                  {{at(DriveTerm::Viscous), 1.0}, {steep, side}}, known(DriveTerm::Viscous)));
    parameters.push_back(combined("coulomb-" + direction, units_.torque,
                                  {{at(DriveTerm::Coulomb), 1.0}, {dry, side}}, known(DriveTerm::Coulomb)));
  }
  return parameters;
}

EstimatedParameter Estimate::single(Eigen::Index first, std::string name, const std::string& unit,
                                    Eigen::Index offset, double factor) const {
  return combined(std::move(name), unit, {{first + offset, factor}});
}

EstimatedParameter Estimate::shape_of(const Variant& variant, std::string name,
                                      const std::string& unit) const {
  const double value = *free_shape(variant);
  return {std::move(name), unit, value, variant.shape_sd > 0.0 ? variant.shape_sd * std::abs(value) : kNaN};
}

std::vector<EstimatedParameter> Estimate::stribeck(const Variant& variant, Eigen::Index first) const {
  std::vector<EstimatedParameter> parameters;
  if (variant.functions.size() > 1) {
    parameters.push_back(combined("rise-forward", units_.torque, {{first, 1.0}, {first + 1, 1.0}}));
    parameters.push_back(combined("rise-backward", units_.torque, {{first, 1.0}, {first + 1, -1.0}}));
  } else {
    parameters.push_back(single(first, "rise", units_.torque));
  }
  parameters.push_back(shape_of(variant, "speed", units_.velocity));
  return parameters;
}

std::vector<EstimatedParameter> Estimate::power_law(const Variant& variant, Eigen::Index first) const {
  std::vector<EstimatedParameter> parameters{single(first, "friction-at-speed", units_.torque)};
  if (variant.functions.size() > 1)
    parameters.push_back(single(first, "difference-by-direction", units_.torque, 1));
  parameters.push_back({"speed", units_.velocity, variant.functions.front().first, kNaN});
  parameters.push_back(shape_of(variant, "power", "1"));
  return parameters;
}

/// a + b u + c u^3 + q P2(u), with Legendre's P2 and u = place / unit, is a spring that stiffens by c from
/// where its stiffness is least, u0 = -q / 2c. Uncertainties to first order.
std::vector<EstimatedParameter> Estimate::stiffening_spring(Eigen::Index first, double unit) const {
  const auto at = [&](int i) { return model_.fit.coefficients[first + i]; };
  const double a = at(1), b = at(0), c = at(2), q = at(3);
  const double u0 = -q / (2.0 * c);
  const double stiffness = b + 1.5 * q * u0, square = 1.5 * u0 * u0 - 0.5;
  const std::string per_length = units_.torque + "/" + units_.position;
  const auto parameter = [&](const char* name, const std::string& unit_name, double value, double by_a,
                             double by_b, double by_c, double by_q, double scale) {
    EstimatedParameter result = combined(name, unit_name,
                                         {{first, by_b * scale},
                                          {first + 1, by_a * scale},
                                          {first + 2, by_c * scale},
                                          {first + 3, by_q * scale}});
    result.value = value * scale;
    return result;
  };
  return {parameter("stiffness", per_length, stiffness, 0.0, 1.0, 3.0 * u0 * u0, 3.0 * u0, 1.0 / unit),
          parameter("slack-at", units_.position, u0, 0.0, 0.0, -u0 / c, -0.5 / c, unit),
          parameter("offset", units_.torque, a + b * u0 + c * u0 * u0 * u0 + q * square, 1.0, u0,
                    u0 * u0 * u0 - stiffness * u0 / c, square - 0.5 * stiffness / c, 1.0),
          parameter("stiffening", per_length + "^3", c, 0.0, 0.0, 1.0, 0.0, std::pow(unit, -3))};
}

std::vector<EstimatedParameter> Estimate::load_position(const Variant& variant, Eigen::Index first) const {
  const double unit = variant.functions.front().second;
  if (variant.functions.size() == 4) return stiffening_spring(first, unit);
  std::vector<EstimatedParameter> parameters{
      single(first, "stiffness", units_.torque + "/" + units_.position, 0, 1.0 / unit)};
  const double slope = model_.fit.coefficients[first];
  for (std::size_t i = 1; i < variant.functions.size(); ++i) {
    const Eigen::Index at = first + static_cast<Eigen::Index>(i);
    if (variant.functions[i].factor == BasisFunction::Factor::PlaceCubed)
      parameters.push_back(combined("stiffening", units_.torque + "/" + units_.position + "^3",
                                    {{at, std::pow(1.0 / unit, 3)}}));
    else if (variant.functions.size() == 2 && slope != 0.0)
      parameters.push_back({"slack-at", units_.position, -model_.fit.coefficients[at] / slope * unit, kNaN});
    else
      parameters.push_back(combined("offset", units_.torque, {{at, 1.0}}));
  }
  return parameters;
}

std::vector<EstimatedParameter> Estimate::drift(const Variant& variant, Eigen::Index first) const {
  std::vector<EstimatedParameter> parameters;
  for (std::size_t i = 0; i < variant.functions.size(); ++i) {
    const BasisFunction& function = variant.functions[i];
    const bool viscous = function.carrier == BasisFunction::Carrier::Velocity;
    const std::string name = function.factor == BasisFunction::Factor::InRun
                                 ? fmt::format("change-in-run-{:.0f}", function.first + 1.0)
                             : function.factor == BasisFunction::Factor::Run  ? "change-per-run"
                             : function.factor == BasisFunction::Factor::Time ? "change-within-run"
                                                                              : "excess-at-start";
    parameters.push_back(single(first, (viscous ? "viscous-" : "") + name,
                                viscous ? units_.per_velocity : units_.torque, static_cast<Eigen::Index>(i)));
  }
  return parameters;
}

std::vector<EstimatedParameter> Estimate::gravity(const Variant& variant, Eigen::Index first) const {
  const auto count = static_cast<Eigen::Index>(variant.functions.size());
  std::vector<EstimatedParameter> parameters{
      amplitude("amplitude", first, count, 1, std::max<Eigen::Index>(1, count / 2))};
  if (count == 2) {
    parameters.push_back(single(first, "sine", units_.torque));
    parameters.push_back(single(first, "cosine", units_.torque, 1));
  }
  parameters.push_back({"multiple", "1", variant.functions.front().first,
                        variant.shape_sd > 0.0 ? variant.shape_sd * variant.functions.front().first : kNaN});
  return parameters;
}

/// A sine and a cosine of the place, of which `period` is one turn.
std::vector<EstimatedParameter> Estimate::wave(const Variant& variant, Eigen::Index first,
                                               const std::string& unit) const {
  EstimatedParameter length = amplitude("amplitude", first, 2, 1, 1);
  length.unit = unit;
  const double factor = variant.functions.front().first;
  return {length,
          single(first, "sine", unit),
          single(first, "cosine", unit, 1),
          {"period", units_.position, 2.0 * M_PI / factor,
           variant.shape_sd > 0.0 ? variant.shape_sd * 2.0 * M_PI / factor : kNaN}};
}

std::vector<EstimatedParameter> Estimate::effect_parameters(const Variant& variant) const {
  Eigen::Index first = 0;
  for (const Variant& part : model_.parts) {
    if (part.name == variant.name) break;
    first += static_cast<Eigen::Index>(part.columns.size());
  }
  const auto one = [&](const char* name, const std::string& unit, Eigen::Index offset = 0,
                       double factor = 1.0) { return single(first, name, unit, offset, factor); };
  const bool two = variant.functions.size() > 1;
  switch (variant.term) {
    case DriveTerm::Inertia:
    case DriveTerm::Viscous:
    case DriveTerm::Coulomb:
      return {};
    case DriveTerm::TorqueOffset:
      return {one("offset", units_.torque)};
    case DriveTerm::FrictionAsymmetry:
      return asymmetry(variant, first);
    case DriveTerm::QuadraticDrag:
      return {one("drag", units_.per_velocity_squared)};
    case DriveTerm::FrictionShape:
      return stribeck(variant, first);
    case DriveTerm::FrictionPower:
      return power_law(variant, first);
    case DriveTerm::Presliding:
      if (!two) return {one("level", units_.torque), shape_of(variant, "length", units_.position)};
      return {one("level", units_.torque), shape_of(variant, "length", units_.position),
              one("damping", units_.per_velocity, 1, -1.0)};
    case DriveTerm::Cogging:
      return cogging(variant, first);
    case DriveTerm::FrictionPosition:
      if (variant.functions.front().factor == BasisFunction::Factor::Sine)
        return wave(variant, first, units_.torque);
      if (!two) return {one("slope", units_.torque)};
      return {one("slope", units_.torque), one("curvature", units_.torque, 1)};
    case DriveTerm::LoadPosition:
      return load_position(variant, first);
    case DriveTerm::InertiaPosition:
      if (variant.functions.front().factor == BasisFunction::Factor::Sine)
        return wave(variant, first, units_.per_acceleration);
      if (!two) return {one("slope", units_.per_acceleration)};
      return {one("slope", units_.per_acceleration), one("curvature", units_.per_acceleration, 1)};
    case DriveTerm::FrictionDrift:
      return drift(variant, first);
    case DriveTerm::Gravity:
      return gravity(variant, first);
    case DriveTerm::LoadFriction:
      return {one("friction-per-load", "1")};
    case DriveTerm::TorqueSaturation:
      return {shape_of(variant, "loss", "1"),
              {"at", units_.torque, variant.functions.front().first, kNaN},
              {"power", "1", variant.functions.front().second, kNaN}};
    case DriveTerm::TorqueLag:
      if (variant.settling_s > 0.0) return {shape_of(variant, "time-constant", "s")};
      return {{"lag", "s", variant.lag_s, variant.shape_sd > 0.0 ? variant.shape_sd : kNaN}};
    case DriveTerm::Regressor: {
      const BasisFunction::Carrier carrier = variant.functions.front().carrier;
      const std::string unit = carrier == BasisFunction::Carrier::Acceleration ? units_.per_acceleration
                               : carrier == BasisFunction::Carrier::Velocity   ? units_.per_velocity
                                                                               : units_.torque;
      if (two) return {one("factor", unit + " per unit"), one("torque-at-mean", units_.torque, 1)};
      return {one("factor", unit + " per unit")};
    }
  }
  return {};
}

}  // namespace clampd::drive
