#include "src/drive/saturation.hpp"

#include <algorithm>
#include <cmath>

namespace clampd::drive {
namespace {

constexpr double kLeastSlope = 0.1;

}  // namespace

double SaturationLaw::last_reading() const {
  return most * std::pow((1.0 - kLeastSlope) / (exponent * loss), 1.0 / (exponent - 1.0));
}

double SaturationLaw::torque(double reading) const {
  if (!(loss > 0.0)) return reading;
  const double size = std::abs(reading), within = std::min(size, last_reading());
  return std::copysign(
      within - loss * most * std::pow(within / most, exponent) + kLeastSlope * (size - within), reading);
}

double SaturationLaw::slope(double reading) const {
  if (!(loss > 0.0)) return 1.0;
  return std::max(kLeastSlope, 1.0 - loss * exponent * std::pow(std::abs(reading) / most, exponent - 1.0));
}

double SaturationLaw::reading(double torque) const {
  if (!(loss > 0.0)) return torque;
  const double last = last_reading(), size = std::abs(torque), torque_there = this->torque(last);
  if (size >= torque_there) return std::copysign(last + (size - torque_there) / kLeastSlope, torque);
  double reading = size;  // from below, where Newton's steps only rise to the root
  for (int step = 0; step < 40; ++step) {
    const double change = (size - this->torque(reading)) / slope(reading);
    reading = std::min(last, reading + change);
    if (std::abs(change) <= 1e-9 * last) break;
  }
  return std::copysign(reading, torque);
}

}  // namespace clampd::drive
