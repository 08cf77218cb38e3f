#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <random>

#include "clampd/identify/estimate.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd::support {

/// Draws brakes wider than the paper's Table II, and sensors of all kinds.
class Draws {
 public:
  explicit Draws(std::uint64_t seed) : random_(seed) {}

  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  double log_uniform(double low, double high) { return std::exp(uniform(std::log(low), std::log(high))); }

  BrakeParameters brake() {
    constexpr std::array<double, kParameterCount> kTableII{0.8, 0.9, 1.66, 0.93, 2.2, 1.05, 0.43};
    BrakeParameters brake;
    for (std::size_t i = 0; i < kParameterCount; ++i)
      brake.theta[static_cast<Eigen::Index>(i)] *= 1.0 + (kTableII[i] - 1.0) * uniform(-0.25, 1.25);
    return brake;
  }
  NoiseLevels noise() {
    return {{log_uniform(5.0, 75.0), log_uniform(0.05, 1.5)}, log_uniform(5e-4, 0.0142)};
  }
  std::mt19937_64& generator() { return random_; }

 private:
  std::mt19937_64 random_;
};

}  // namespace clampd::support
