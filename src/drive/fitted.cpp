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

/// Whether a term loads the drive, rather than rubs: friction that grows with load grows with it.
bool loads(DriveTerm term) {
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

double torque_of(const FittedTerm& term, const DriveState& state, double load, double balance) {
  double torque = 0.0;
  for (std::size_t i = 0; i < term.functions.size(); ++i)
    torque += term.coefficients[i] * value_of(term.functions[i], state, load, balance);
  return torque;
}

}  // namespace

double value_of(const BasisFunction& function, const DriveState& state, double load, double balance) {
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
    case Factor::Load:
      return carrier * std::abs(load);
    case Factor::Balance:
      return carrier * balance;
    case Factor::BalanceCubed:
      return carrier * balance * balance * balance / (function.first * function.first);
  }
  return 0.0;
}

double torque_of(const FittedDrive& drive, const DriveState& state) {
  double load = 0.0, balance = 0.0;
  for (const FittedTerm& term : drive.terms)
    if (loads(term.term)) load += torque_of(term, state, 0.0, 0.0);
  for (const FittedTerm& term : drive.terms)
    if (term.term != DriveTerm::TorqueSaturation) balance += torque_of(term, state, load, 0.0);
  double torque = balance;
  for (const FittedTerm& term : drive.terms)
    if (term.term == DriveTerm::TorqueSaturation) torque += torque_of(term, state, load, balance);
  return torque;
}

}  // namespace clampd
