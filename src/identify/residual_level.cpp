#include "clampd/identify/residual_level.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "src/identify/starting_point.hpp"

namespace clampd {

namespace {

constexpr double kFarAbove = 10.0;        // times the noise
constexpr double kShareOfReading = 0.05;  // of what the reading does
constexpr double kShareOfTorque = 1.0;

/// Root mean square of a column of all runs, about its mean or about zero.
double size_of(std::span<const Run> runs, const std::vector<double> Run::*column, bool about_mean) {
  double sum = 0.0;
  double squares = 0.0;
  double rows = 0.0;
  for (const Run& run : runs)
    for (const double value : run.*column) {
      sum += value;
      squares += value * value;
      rows += 1.0;
    }
  const double mean = about_mean ? sum / rows : 0.0;
  return std::sqrt(std::max(0.0, squares / rows - mean * mean));
}

}  // namespace

ResidualLevel residual_level(std::span<const Run> runs, const NoiseLevels& left) {
  const SensorNoise noise = identify::noise_without_model(runs);
  ResidualLevel level{.force = left.sensors.force_N / noise.force_N,
                      .velocity = left.sensors.velocity_rad_s / noise.velocity_rad_s,
                      .words = {}};
  const bool force =
      level.force > kFarAbove && left.sensors.force_N > kShareOfReading * size_of(runs, &Run::force_N, true);
  const bool velocity =
      level.velocity > kFarAbove &&
      left.sensors.velocity_rad_s > kShareOfReading * size_of(runs, &Run::velocity_rad_s, true);
  const bool torque = left.torque_Nm > kShareOfTorque * size_of(runs, &Run::torque_Nm, false);
  level.far_above_noise = force || velocity || torque;
  if (force || (!velocity && !torque && level.force >= level.velocity))
    level.words = fmt::format("the force by {:.0f} N rms, {:.3g} times the noise of its reading",
                              left.sensors.force_N, level.force);
  else if (velocity || !torque)
    level.words = fmt::format("the velocity by {:.3g} rad/s rms, {:.3g} times the noise of its reading",
                              left.sensors.velocity_rad_s, level.velocity);
  else
    level.words = fmt::format("the torque by {:.2g} N m rms, more than the torque itself", left.torque_Nm);
  return level;
}

}  // namespace clampd
