#pragma once

#include <array>
#include <cstddef>
#include <random>
#include <string>
#include <vector>

#include "clampd/brake/simulation.hpp"

namespace clampd::support {

inline constexpr std::size_t kBlockSamples = 20;

/// Fifteen torque blocks (N m) that excite the nominal brake well from rest at contact: the best of a random
/// search for log det of the information (73.9 with unknown initial state at 75 N, 1.5 rad/s), within 30 kN
/// and 300 rad/s.
inline constexpr std::array<double, 15> kStrongBlocks_Nm{0.78, -0.62, -0.054, -0.14, 0.97,  0.27, 0.30, 2.85,
                                                         0.18, 0.87,  0.49,   -1.05, -0.17, 0.02, -0.58};

inline std::vector<double> strong_torque() {
  std::vector<double> torque;
  for (const double block : kStrongBlocks_Nm) torque.insert(torque.end(), kBlockSamples, block);
  return torque;
}

/// A run from noise-free readings at 1 ms plus white Gaussian sensor noise.
inline Run noisy_run(const std::vector<double>& torque_Nm, const std::vector<double>& force_N,
                     const std::vector<double>& velocity_rad_s, double noise_force_N,
                     double noise_velocity_rad_s, std::mt19937_64& generator) {
  std::normal_distribution<double> normal;
  Run run;
  run.name = "simulated";
  for (std::size_t k = 0; k < torque_Nm.size(); ++k) {
    run.time_s.push_back(1e-3 * static_cast<double>(k));
    run.torque_Nm.push_back(torque_Nm[k]);
    run.force_N.push_back(force_N[k] + noise_force_N * normal(generator));
    run.velocity_rad_s.push_back(velocity_rad_s[k] + noise_velocity_rad_s * normal(generator));
  }
  return run;
}

}  // namespace clampd::support
