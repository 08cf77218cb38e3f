#include "src/diagnose/evidence.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/statistics/distributions.hpp"

namespace clampd::diagnosing {

double neg_log_p_of_chi_square(double statistic, double degrees) {
  if (!(statistic > 0.0)) return 0.0;
  return statistics::chi_squared_neg_log_p(statistic, degrees);
}

double significance_of(double gain_nats, double degrees, double alternatives) {
  return neg_log_p_of_chi_square(2.0 * gain_nats, degrees) - std::log(std::max(1.0, alternatives));
}

double neg_log_p_of_f(double statistic, double degrees, double other_degrees) {
  if (!(statistic > 0.0)) return 0.0;
  return -std::log(std::max(statistics::fisher_f_p_value(statistic, degrees, other_degrees), 1e-300));
}

double p_value_of(double neg_log_p, double tried) {
  return -std::expm1(tried * std::log1p(-std::exp(-std::max(0.0, neg_log_p))));
}

}  // namespace clampd::diagnosing
