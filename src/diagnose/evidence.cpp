#include "src/diagnose/evidence.hpp"

#include <algorithm>
#include <cmath>

#include <boost/math/distributions/fisher_f.hpp>
#include <boost/math/special_functions/gamma.hpp>

namespace clampd::diagnosing {

double surprise_of_chi_square(double statistic, double degrees) {
  if (!(statistic > 0.0) || !(degrees > 0.0)) return 0.0;
  const double half = 0.5 * degrees;
  const double x = 0.5 * statistic;
  const double probability = boost::math::gamma_q(half, x);
  if (probability > 1e-250) return -std::log(probability);
  // Beyond the smallest numbers: the tail's leading terms. Not std::lgamma: it writes a global sign.
  return x - (half - 1.0) * std::log(x) + boost::math::lgamma(half) - std::log1p((half - 1.0) / x);
}

double evidence_of(double gain_nats, double degrees, double alternatives) {
  return surprise_of_chi_square(2.0 * gain_nats, degrees) - std::log(std::max(1.0, alternatives));
}

double surprise_of_f(double statistic, double degrees, double other_degrees) {
  if (!(statistic > 0.0) || !(degrees > 0.0) || !(other_degrees > 0.0)) return 0.0;
  const double probability =
      boost::math::cdf(boost::math::complement(boost::math::fisher_f(degrees, other_degrees), statistic));
  return -std::log(std::max(probability, 1e-300));
}

double p_value_of(double surprise, double tried) {
  return -std::expm1(tried * std::log1p(-std::exp(-std::max(0.0, surprise))));
}

}  // namespace clampd::diagnosing
