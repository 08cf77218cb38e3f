#pragma once

#include <array>
#include <span>

#include <Eigen/Core>

#include "clampd/identify/information.hpp"

namespace clampd::identify {

/// Standard deviations of the weak prior of a run's initial position and velocity.
inline constexpr std::array<double, 2> kInitialStatePrior{kInitialPositionPrior_rad,
                                                          kInitialVelocityPrior_rad_s};

/// Adds a prior with these standard deviations to normal equations whose last unknowns before the data are an
/// initial state; `distance` is how far that is from the prior's centre.
template <class Distance, class Normal>
void add_prior(std::span<const double> deviations, const Distance& distance, Normal& normal) {
  const Eigen::Index data = normal.rows() - 1;
  for (Eigen::Index i = 0; i < distance.size(); ++i) {
    const Eigen::Index at = data - distance.size() + i;
    const double deviation = deviations[static_cast<std::size_t>(i)];
    const double weight = 1.0 / (deviation * deviation);
    normal(at, at) += weight;
    normal(at, data) += weight * distance[i];
    normal(data, at) += weight * distance[i];
    normal(data, data) += weight * distance[i] * distance[i];
  }
}

/// What it adds to the squares.
template <class Distance>
double prior_squares(std::span<const double> deviations, const Distance& distance) {
  return distance.cwiseQuotient(Eigen::Map<const Distance>(deviations.data(), distance.size())).squaredNorm();
}

}  // namespace clampd::identify
