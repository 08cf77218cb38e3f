#pragma once

namespace clampd::diagnosing {

/// -ln P(chi-square with `degrees` > 2 gain): how surprising a gain of so many nats is for so many further
/// parameters if they mean nothing; less the logarithm of the alternatives that were tried for it.
double significance_of(double gain_nats, double degrees, double alternatives = 1.0);

/// -ln P for a chi-square statistic.
double neg_log_p_of_chi_square(double statistic, double degrees);

/// -ln P for an F statistic.
double neg_log_p_of_f(double statistic, double degrees, double other_degrees);

/// That one of `tried` independent candidates is as surprising by chance (Šidák).
double p_value_of(double neg_log_p, double tried = 1.0);

}  // namespace clampd::diagnosing
