#pragma once

/// Probabilities and quantiles of the distributions that tests and intervals need. All functions return NaN
/// for a statistic that is NaN, and throw nothing.
namespace clampd::statistics {

/// Probability that a chi-squared variable of so many degrees of freedom exceeds `statistic`. 1 for degrees
/// <= 0.
double chi_squared_p_value(double statistic, double degrees);

/// -ln of chi_squared_p_value(), also where the probability itself is too small for a double. 0 for degrees
/// <= 0.
double chi_squared_neg_log_p(double statistic, double degrees);

/// The value that a chi-squared variable exceeds with this probability, in (0, 1).
double chi_squared_upper_quantile(double probability, double degrees);

/// Probability that Fisher's F with these degrees of freedom exceeds `statistic`.
double fisher_f_p_value(double statistic, double degrees, double other_degrees);

/// The value that Student's t exceeds with this probability, in (0, 1).
double student_t_upper_quantile(double probability, double degrees);

/// The value that a standard normal variable stays below with this probability, in (0, 1).
double normal_quantile(double probability);

/// Probability that a standard normal variable exceeds `z`.
double normal_upper_tail(double z);

}  // namespace clampd::statistics
