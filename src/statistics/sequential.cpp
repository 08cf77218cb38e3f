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

  /// Nodes over an interval, four in each two widths: of the narrower one of the kernels that made f and that it
  /// goes into.
  Paths(double from, double to, double width) {
    constexpr std::array kNodes{-0.8611363115940526, -0.3399810435848563, 0.3399810435848563,
                                0.8611363115940526};
    constexpr std::array kWeights{0.3478548451374538, 0.6521451548625461, 0.6521451548625461,
                                  0.3478548451374538};
    const auto panels = std::max(1, static_cast<int>(std::ceil((to - from) / (2.0 * width))));
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
  /// Of the share that each look adds.
  const auto share_sd = [&](std::size_t look) {
    return std::sqrt(information[look] - (look > 0 ? information[look - 1] : 0.0));
  };
  const auto paths_below = [&](std::size_t look) {
    const double sd = std::sqrt(information[look]);
    return Paths(std::min(-kFar, factor - 2.0) * sd, factor * sd, std::min(share_sd(look), share_sd(look + 1)));
  };
  double crossed = normal_upper_tail(factor);
  if (information.size() == 1) return crossed;
  Paths paths = paths_below(0);
  const double sd = share_sd(0);
  for (std::size_t i = 0; i < paths.x.size(); ++i) paths.f[i] = density(paths.x[i] / sd) / sd;
  for (std::size_t look = 1; look < information.size(); ++look) {
    const double bound = factor * std::sqrt(information[look]);
    for (std::size_t i = 0; i < paths.x.size(); ++i)
      crossed += paths.weight[i] * paths.f[i] * normal_upper_tail((bound - paths.x[i]) / share_sd(look));
    if (look + 1 == information.size()) break;
    Paths next = paths_below(look);
    propagate(paths, share_sd(look), next);
    paths = std::move(next);
  }
  return crossed;
}

}  // namespace

double repeated_look_factor(double probability, std::span<const double> information) {
  CLAMPD_ASSERT(probability > 0.0 && probability < 1.0 && !information.empty() && information[0] > 0.0);
  for (std::size_t look = 1; look < information.size(); ++look)
    CLAMPD_ASSERT(information[look] > information[look - 1]);
  double low = -normal_quantile(probability);
  if (information.size() == 1) return low;
  double high = -normal_quantile(probability / static_cast<double>(information.size()));  // Bonferroni
  constexpr double kAccuracy = 2e-4;
  while (high - low > kAccuracy) {
    const double middle = 0.5 * (low + high);
    (crossing_probability(middle, information) > probability ? low : high) = middle;
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
