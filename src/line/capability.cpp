#include "clampd/line/capability.hpp"

#include <algorithm>
#include <cmath>
#include <limits>


#include "clampd/base/assert.hpp"
#include "clampd/line/constants.hpp"
#include "clampd/statistics/distributions.hpp"

namespace clampd::quality {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kMovingRangeFreedom = 0.62;  ///< per value after the first

struct Scatter {
  double sd = 0.0;
  double freedom = 0.0;
};

CapabilityIndex potential(const Scatter& scatter, double width, double confidence) {
  if (!std::isfinite(width) || !(scatter.sd > 0.0)) return {kNone, kNone, kNone};
  const double value = width / (6.0 * scatter.sd);
  const double tail = 0.5 * (1.0 - confidence);
  const auto factor = [&](double probability) {
    return std::sqrt(statistics::chi_squared_upper_quantile(1.0 - probability, scatter.freedom) / scatter.freedom);
  };
  return {value, value * factor(tail), value * factor(1.0 - tail)};
}

CapabilityIndex actual(const Scatter& scatter, double mean, std::size_t n, double lower, double upper,
                       double confidence) {
  double margin = std::numeric_limits<double>::infinity();
  if (std::isfinite(lower)) margin = std::min(margin, mean - lower);
  if (std::isfinite(upper)) margin = std::min(margin, upper - mean);
  if (!std::isfinite(margin) || !(scatter.sd > 0.0)) return {kNone, kNone, kNone};
  const double value = margin / (3.0 * scatter.sd);
  const double z = statistics::normal_quantile(0.5 * (1.0 + confidence));
  const double half =
      z * std::sqrt(1.0 / (9.0 * static_cast<double>(n)) + value * value / (2.0 * scatter.freedom));
  return {value, value - half, value + half};
}

}  // namespace

Capability capability(std::span<const double> values, double lower_limit, double upper_limit,
                      double confidence) {
  CLAMPD_ASSERT(values.size() >= 2 && confidence > 0.0 && confidence < 1.0);
  Capability result;
  result.n = values.size();
  const double n = static_cast<double>(result.n);
  for (const double value : values) result.mean += value / n;
  double squares = 0.0, moving = 0.0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    squares += (values[i] - result.mean) * (values[i] - result.mean);
    if (i > 0) moving += std::abs(values[i] - values[i - 1]);
  }
  result.sd_overall = std::sqrt(squares / (n - 1.0));
  result.sd_within = moving / (n - 1.0) / range_mean(2);
  const Scatter within{result.sd_within, kMovingRangeFreedom * (n - 1.0)};
  const Scatter overall{result.sd_overall, n - 1.0};
  const double width = upper_limit - lower_limit;
  result.cp = potential(within, width, confidence);
  result.cpk = actual(within, result.mean, result.n, lower_limit, upper_limit, confidence);
  result.pp = potential(overall, width, confidence);
  result.ppk = actual(overall, result.mean, result.n, lower_limit, upper_limit, confidence);
  return result;
}

}  // namespace clampd::quality
