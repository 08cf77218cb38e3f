#include "clampd/statistics/sequential.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <span>
#include <vector>

#include "clampd/base/assert.hpp"
#include "clampd/statistics/distributions.hpp"

namespace clampd::statistics {
namespace {

double density(double z) {
  return std::exp(-0.5 * z * z) / std::sqrt(2.0 * std::numbers::pi);
}

/// Further than this a standard normal variable is never found.
constexpr double kFar = 7.0;

/// Where the sum stands, among the paths that have not crossed: f(x) at Gauss's nodes, in ascending order.
struct Paths {
  std::vector<double> x, weight, f;

  /// Nodes over an interval, four in each two units: the kernel's own width is one.
  Paths(double from, double to) {
    constexpr std::array kNodes{-0.8611363115940526, -0.3399810435848563, 0.3399810435848563,
                                0.8611363115940526};
    constexpr std::array kWeights{0.3478548451374538, 0.6521451548625461, 0.6521451548625461,
                                  0.3478548451374538};
    const auto panels = std::max(1, static_cast<int>(std::ceil((to - from) / 2.0)));
    const double half = 0.5 * (to - from) / panels;
    for (int i = 0; i < panels; ++i)
      for (std::size_t k = 0; k < kNodes.size(); ++k) {
        x.push_back(from + (2.0 * i + 1.0 + kNodes[k]) * half);
        weight.push_back(kWeights[k] * half);
      }
    f.assign(x.size(), 0.0);
  }
};

/// f after one more share of information, of this standard deviation, on the nodes of `next`.
void propagate(const Paths& paths, double sd, Paths& next) {
  std::size_t first = 0;
  for (std::size_t i = 0; i < next.x.size(); ++i) {
    while (first < paths.x.size() && paths.x[first] < next.x[i] - kFar * sd) ++first;
    for (std::size_t j = first; j < paths.x.size() && paths.x[j] <= next.x[i] + kFar * sd; ++j)
      next.f[i] += paths.weight[j] * paths.f[j] * density((next.x[i] - paths.x[j]) / sd) / sd;
  }
}

/// That a sum of independent normal shares, with the variance `information` at each look, ever exceeds factor
/// standard deviations there.
double crossing_probability(double factor, std::span<const double> information) {
  const auto paths_below = [factor](double variance) {
    const double bound = factor * std::sqrt(variance);
    return Paths(std::min(-kFar * std::sqrt(variance), bound - 2.0), bound);
  };
  double crossed = normal_upper_tail(factor);
  Paths paths = paths_below(information.front());
  const double sd = std::sqrt(information.front());
  for (std::size_t i = 0; i < paths.x.size(); ++i) paths.f[i] = density(paths.x[i] / sd) / sd;
  for (std::size_t look = 1; look < information.size(); ++look) {
    const double share_sd = std::sqrt(information[look] - information[look - 1]);
    const double bound = factor * std::sqrt(information[look]);
    for (std::size_t i = 0; i < paths.x.size(); ++i)
      crossed += paths.weight[i] * paths.f[i] * normal_upper_tail((bound - paths.x[i]) / share_sd);
    if (look + 1 == information.size()) break;
    Paths next = paths_below(information[look]);
    propagate(paths, share_sd, next);
    paths = std::move(next);
  }
  return crossed;
}

}  // namespace

double repeated_look_factor(double probability, std::span<const double> information) {
  CLAMPD_ASSERT(probability > 0.0 && probability < 1.0 && !information.empty() && information[0] > 0.0);
  // The nodes are dense enough for shares of one and more.
  double least = information[0];
  for (std::size_t look = 1; look < information.size(); ++look)
    least = std::min(least, information[look] - information[look - 1]);
  CLAMPD_ASSERT(least > 0.0);
  std::vector<double> scaled(information.begin(), information.end());
  for (double& value : scaled) value /= least;
  double low = -normal_quantile(probability);
  if (scaled.size() == 1) return low;
  double high = -normal_quantile(probability / static_cast<double>(scaled.size()));  // Bonferroni
  constexpr double kAccuracy = 2e-4;
  while (high - low > kAccuracy) {
    const double middle = 0.5 * (low + high);
    (crossing_probability(middle, scaled) > probability ? low : high) = middle;
  }
  return high;
}

double repeated_look_factor(double probability, int first, int most) {
  CLAMPD_ASSERT(first >= 1 && most >= first);
  std::vector<double> information;
  for (int n = first; n <= most; ++n) information.push_back(n);
  return repeated_look_factor(probability, information);
}

double with_estimated_deviation(double factor, double degrees) {
  if (std::isinf(degrees)) return factor;
  return student_t_upper_quantile(normal_upper_tail(factor), degrees);
}

}  // namespace clampd::statistics
