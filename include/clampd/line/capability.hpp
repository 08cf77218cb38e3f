#pragma once

#include <cstddef>
#include <span>

namespace clampd::quality {

/// An index with its two-sided confidence interval. NaN where it cannot be told.
struct CapabilityIndex {
  double value = 0.0;
  double lower = 0.0;
  double upper = 0.0;
};

/// How well a process keeps within its limits. Cp and Cpk use the short-term scatter (average moving range of
/// two over d2), Pp and Ppk the overall standard deviation.
struct Capability {
  std::size_t n = 0;
  double mean = 0.0;
  double sd_within = 0.0;
  double sd_overall = 0.0;
  CapabilityIndex cp;  ///< NaN if a limit is missing, so pp
  CapabilityIndex cpk;
  CapabilityIndex pp;
  CapabilityIndex ppk;
};

/// Of values in the order of time. At least two; a limit that is not finite does not exist. Intervals: Cp and
/// Pp by chi-square, Cpk and Ppk by Bissell's approximation (Montgomery, Introduction to Statistical Quality
/// Control, 8.3); the average moving range counts as 0.62 (n - 1) degrees of freedom (Wheeler).
Capability capability(std::span<const double> values, double lower_limit, double upper_limit,
                      double confidence = 0.95);

}  // namespace clampd::quality
