#include <algorithm>
#include <cmath>

#include "clampd/drive/model.hpp"
#include "src/drive/saturation.hpp"

namespace clampd {
namespace {

using Carrier = BasisFunction::Carrier;
using Factor = BasisFunction::Factor;

double carried(Carrier carrier, const DriveState& state) {
  switch (carrier) {
    case Carrier::One:
      return 1.0;
    case Carrier::Acceleration:
      return state.acceleration;
    case Carrier::Velocity:
      return state.velocity;
    case Carrier::Direction:
      return state.direction;
    case Carrier::Sliding:
      return std::abs(state.direction);
  }
  return 0.0;
}

double column_of(const BasisFunction& function, const DriveState& state) {
  const auto index = static_cast<std::size_t>(function.index);
  return index < state.columns.size() ? state.columns[index] : 0.0;
}

double torque_of(const FittedTerm& term, const DriveState& state, const TermSums& sums) {
  double torque = 0.0;
  for (std::size_t i = 0; i < term.functions.size(); ++i)
    torque += term.coefficients[i] * value_of(term.functions[i], state, sums);
  return torque;
}

}  // namespace

double travel_after_reversal(double travel, double length) {
  return -length * std::log1p(-std::exp(-travel / length));
}

std::vector<double> settled(std::span<const double> time_s, std::span<const double> values,
                            double settling_s) {
  std::vector<double> result(values.begin(), values.end());
  if (!(settling_s > 0.0)) return result;
  for (std::size_t i = 1; i < values.size(); ++i) {
    const double step_s = time_s[i] - time_s[i - 1];
    if (!(step_s > 0.0)) continue;
    const double behind = settling_s * (values[i] - values[i - 1]) / step_s;
    result[i] =
        values[i] - behind + (result[i - 1] - values[i - 1] + behind) * std::exp(-step_s / settling_s);
  }
  return result;
}

bool loads_drive(DriveTerm term) {
  switch (term) {
    case DriveTerm::Inertia:
    case DriveTerm::InertiaPosition:
    case DriveTerm::Gravity:
    case DriveTerm::TorqueOffset:
    case DriveTerm::LoadPosition:
    case DriveTerm::Regressor:
      return true;
    default:
      return false;
  }
}

std::vector<std::string> terms_of_runs(const FittedDrive& drive) {
  const auto is_of_a_run = [](const BasisFunction& function) {
    const bool column = function.factor == Factor::Column || function.factor == Factor::ColumnSize;
    return function.factor == Factor::Run || function.factor == Factor::InRun ||
           (function.index >= 0 && !column);
  };
  std::vector<std::string> names;
  for (const FittedTerm& term : drive.terms)
    if (std::ranges::any_of(term.functions, is_of_a_run)) names.push_back(term.name);
  return names;
}

bool accelerates(const FittedTerm& term) {
  return std::ranges::any_of(term.functions, [](const BasisFunction& function) {
    return function.carrier == Carrier::Acceleration;
  });
}

namespace {

/// Of an inertia that depends on the place: half of its slope times the square of the speed, without which
/// energy would not be conserved.
double slope_of_inertia(const BasisFunction& function, const DriveState& state) {
  if (function.index >= 0 && function.index != state.run) return 0.0;
  const double place = (state.position - function.first) / function.second;
  switch (function.factor) {
    case Factor::Place:
      return 1.0 / function.second;
    case Factor::PlaceSquared:
      return 3.0 * place / function.second;
    case Factor::PlaceCubed:
      return 3.0 * place * place / function.second;
    case Factor::Cosine:
      return -function.first * std::sin(function.first * state.position);
    case Factor::Sine:
      return function.first * std::cos(function.first * state.position);
    default:
      return 0.0;
  }
}

}  // namespace

double value_of(const BasisFunction& function, const DriveState& state, const TermSums& sums) {
  if (function.carrier == Carrier::Acceleration) {
    BasisFunction factor = function;
    factor.carrier = Carrier::One;
    return state.acceleration * value_of(factor, state, sums) +
           0.5 * state.velocity * state.velocity * slope_of_inertia(function, state);
  }
  const double carrier = carried(function.carrier, state);
  if (carrier == 0.0) return 0.0;
  const auto place = [&] { return (state.position - function.first) / function.second; };
  const bool elsewhere = function.index >= 0 && function.index != state.run;
  switch (function.factor) {
    case Factor::One:
      return carrier;
    case Factor::Power:
      return carrier * std::pow(std::abs(state.velocity) / function.first, function.second);
    case Factor::Stribeck:
      return carrier * std::exp(-std::pow(std::abs(state.velocity) / function.first, function.second));
    case Factor::Reversal:
      return -carrier * std::exp(-state.travel / function.first);
    case Factor::Place:
      return elsewhere ? 0.0 : carrier * place();
    case Factor::PlaceSquared:
      return elsewhere ? 0.0 : carrier * (1.5 * place() * place() - 0.5);
    case Factor::PlaceCubed:
      return elsewhere ? 0.0 : carrier * place() * place() * place();
    case Factor::Cosine:
      return elsewhere ? 0.0 : carrier * std::cos(function.first * state.position);
    case Factor::Sine:
      return elsewhere ? 0.0 : carrier * std::sin(function.first * state.position);
    case Factor::Time:
      return carrier * (state.time_s - function.first) / function.second;
    case Factor::TimeDecay:
      return carrier * std::exp(-state.time_s / function.first);
    case Factor::Run:
      return carrier * (state.run - function.first);
    case Factor::InRun:
      return state.run == static_cast<int>(function.first) ? carrier : 0.0;
    case Factor::Column:
      return carrier * (column_of(function, state) - function.first);
    case Factor::ColumnSize:
      return carrier * std::abs(column_of(function, state));
    case Factor::StaticLoad:
      return carrier * std::abs(sums.static_load);
    case Factor::Load:
      return carrier * std::abs(sums.load);
    case Factor::Balance:
      return carrier * sums.balance;
    case Factor::BalancePower:
      return carrier * std::copysign(function.first, sums.balance) *
             std::pow(std::abs(sums.balance) / function.first, function.second);
  }
  return 0.0;
}

double torque_of(const FittedDrive& drive, const DriveState& state) {
  TermSums sums;
  for (const FittedTerm& term : drive.terms) {
    if (!loads_drive(term.term)) continue;
    const double torque = torque_of(term, state, {});
    sums.load += torque;
    if (!accelerates(term)) sums.static_load += torque;
  }
  for (const FittedTerm& term : drive.terms)
    if (term.term != DriveTerm::TorqueSaturation) sums.balance += torque_of(term, state, sums);
  for (const FittedTerm& term : drive.terms)
    if (term.term == DriveTerm::TorqueSaturation)
      return drive::SaturationLaw{torque_of(term, state, {0.0, 0.0, 1.0}), 1.0, term.functions.front().second}
          .reading(sums.balance);
  return sums.balance;
}

}  // namespace clampd
