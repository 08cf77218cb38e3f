#include "clampd/statistics/distributions.hpp"

#include <cmath>
#include <numbers>

#include <boost/math/distributions/fisher_f.hpp>
#include <boost/math/distributions/normal.hpp>
#include <boost/math/distributions/students_t.hpp>
#include <boost/math/special_functions/gamma.hpp>

namespace clampd::statistics {

double chi_squared_p_value(double statistic, double degrees) {
  if (std::isnan(statistic)) return statistic;
  if (!(statistic > 0.0) || !(degrees > 0.0)) return 1.0;
  if (std::isinf(statistic)) return 0.0;
  return boost::math::gamma_q(0.5 * degrees, 0.5 * statistic);
}

double chi_squared_neg_log_p(double statistic, double degrees) {
  const double probability = chi_squared_p_value(statistic, degrees);
  if (!(probability <= 1e-250) || std::isinf(statistic)) return -std::log(probability);
  // Beyond the smallest numbers: the tail's leading terms. Not std::lgamma: it writes a global sign.
  const double half = 0.5 * degrees;
  const double x = 0.5 * statistic;
  return x - (half - 1.0) * std::log(x) + boost::math::lgamma(half) - std::log1p((half - 1.0) / x);
}

double chi_squared_upper_quantile(double probability, double degrees) {
  return 2.0 * boost::math::gamma_q_inv(0.5 * degrees, probability);
}

double fisher_f_p_value(double statistic, double degrees, double other_degrees) {
  if (std::isnan(statistic)) return statistic;
  if (!(statistic > 0.0) || !(degrees > 0.0) || !(other_degrees > 0.0)) return 1.0;
  if (std::isinf(statistic)) return 0.0;
  return boost::math::cdf(boost::math::complement(boost::math::fisher_f(degrees, other_degrees), statistic));
}

double student_t_upper_quantile(double probability, double degrees) {
  return boost::math::quantile(boost::math::complement(boost::math::students_t(degrees), probability));
}

double normal_quantile(double probability) {
  return boost::math::quantile(boost::math::normal(), probability);
}

double normal_upper_tail(double z) {
  return 0.5 * std::erfc(z / std::numbers::sqrt2);
}

}  // namespace clampd::statistics
