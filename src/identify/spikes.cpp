#include "clampd/identify/spikes.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/statistics/median.hpp"

namespace clampd {

namespace {

constexpr double kSpike = 5.5;
constexpr std::size_t kNearby = 10;

/// Of a standard normal variable's magnitude.
constexpr double kMedian = 0.6745;

}  // namespace

double spike_limit(std::vector<double> innovations) {
  std::erase_if(innovations, [](double e) { return !std::isfinite(e); });
  for (double& e : innovations) e = std::abs(e);
  return kSpike * statistics::median(innovations) / kMedian;
}

std::vector<std::size_t> spikes_in(std::span<const double> innovations, double limit) {
  std::vector<std::size_t> rows;
  for (std::size_t k = 0; k < innovations.size(); ++k) {
    const double size = std::abs(innovations[k]);
    if (!(size > limit)) continue;
    const std::size_t first = k > kNearby ? k - kNearby : 0;
    const std::size_t last = std::min(innovations.size(), k + kNearby + 1);
    const auto near = innovations.subspan(first, last - first);
    if (std::none_of(near.begin(), near.end(), [&](double e) { return std::abs(e) > size; }))
      rows.push_back(k);
  }
  return rows;
}

}  // namespace clampd
