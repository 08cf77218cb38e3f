#include "clampd/line/constants.hpp"

#include <cmath>

#include <boost/math/quadrature/gauss.hpp>
#include <boost/math/special_functions/gamma.hpp>

#include "clampd/base/assert.hpp"
#include "clampd/statistics/distributions.hpp"

namespace clampd::quality {
namespace {

using Gauss = boost::math::quadrature::gauss<double, 60>;
constexpr double kFar = 8.5;  ///< standard deviations, beyond which nothing is left

double phi(double x) {
  return statistics::normal_upper_tail(-x);
}

}  // namespace

double range_mean(int n) {
  CLAMPD_ASSERT(n >= 2 && n <= 100);
  return Gauss::integrate([n](double x) { return 1.0 - std::pow(phi(x), n) - std::pow(1.0 - phi(x), n); },
                          -kFar, kFar);
}

double range_sd(int n) {
  // E[W^2] = 2 times the integral over x < y of P(smallest <= x, largest > y)
  const double mean = range_mean(n);
  const double square = 2.0 * Gauss::integrate(
                                  [n](double x) {
                                    return Gauss::integrate(
                                        [n, x](double y) {
                                          return 1.0 - std::pow(phi(y), n) - std::pow(1.0 - phi(x), n) +
                                                 std::pow(phi(y) - phi(x), n);
                                        },
                                        x, kFar);
                                  },
                                  -kFar, kFar);
  return std::sqrt(square - mean * mean);
}

double deviation_mean(int n) {
  CLAMPD_ASSERT(n >= 2);
  return std::sqrt(2.0 / (n - 1)) *
         std::exp(boost::math::lgamma(0.5 * n) - boost::math::lgamma(0.5 * (n - 1)));
}

double average_range_mean(int n, int groups) {
  CLAMPD_ASSERT(groups >= 1);
  const double mean = range_mean(n), sd = range_sd(n);
  return std::sqrt(mean * mean + sd * sd / groups);
}

}  // namespace clampd::quality
