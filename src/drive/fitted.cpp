#include <cmath>

#include "clampd/drive/model.hpp"

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

bool accelerates(DriveTerm term) {
  return term == DriveTerm::Inertia || term == DriveTerm::InertiaPosition;
}

double value_of(const BasisFunction& function, const DriveState& state, const TermSums& sums) {
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
    case Factor::BalanceCubed:
      return carrier * sums.balance * sums.balance * sums.balance / (function.first * function.first);
  }
  return 0.0;
}

double torque_of(const FittedDrive& drive, const DriveState& state) {
  TermSums sums;
  for (const FittedTerm& term : drive.terms) {
    if (!loads_drive(term.term)) continue;
    const double torque = torque_of(term, state, {});
    sums.load += torque;
    if (!accelerates(term.term)) sums.static_load += torque;
  }
  for (const FittedTerm& term : drive.terms)
    if (term.term != DriveTerm::TorqueSaturation) sums.balance += torque_of(term, state, sums);
  double torque = sums.balance;
  for (const FittedTerm& term : drive.terms)
    if (term.term == DriveTerm::TorqueSaturation) torque += torque_of(term, state, sums);
  return torque;
}

}  // namespace clampd
