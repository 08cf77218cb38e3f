#pragma once

#include <array>
#include <cstddef>
#include <utility>
#include <vector>

#include "tools/reproduce/study.hpp"

namespace clampd::reproduce {

/// Table II as printed.
struct PaperColumn {
  std::array<double, kParameterCount> mean;
  std::array<double, kParameterCount> variance;
  double sum_of_variances;  ///< as its text states
};
inline constexpr PaperColumn kPaperOemOptimal{{0.799, 0.902, 1.662, 0.930, 2.216, 1.051, 0.426},
                                              {0.00416, 0.00324, 0.01432, 0.01488, 0.05971, 0.01833, 0.01217},
                                              0.00480};
inline constexpr PaperColumn kPaperPemOptimal{{0.844, 0.936, 1.668, 0.921, 2.450, 0.875, 0.406},
                                              {0.00433, 0.00090, 0.00603, 0.00848, 0.06599, 0.00236, 0.02671},
                                              0.00388};
inline constexpr PaperColumn kPaperOemStep{{0.815, 0.891, 1.609, 0.925, 1.660, 0.962, 0.384},
                                           {0.00488, 0.00440, 0.00959, 0.01999, 0.01876, 0.02159, 0.01326},
                                           0.00729};

/// How long something stays at v = 0.
struct Rest {
  double begin_s = 0.0;  ///< of the longest
  double longest_s = 0.0;
};

/// How one set of parameters replays the sinusoids. A lock-up is a rest that is 10 ms longer than the brake's
/// longest in the same repeat.
struct ReplayFigures {
  std::size_t locked = 0;  ///< repeats with a lock-up
  double longest_s = 0.0;  ///< rest of any repeat
  double median_force_rms_N = 0.0;
  double worst_force_rms_N = 0.0;
};

/// The pairs of Fig. 5.
inline constexpr std::array<std::pair<Parameter, Parameter>, 4> kFigure5_pairs{
    {{k1, k2}, {TC, Tv}, {Ts0, mus}, {ws, TC}}};

/// The lengths of Fig. 1.
inline constexpr std::array<std::size_t, 4> kFigure1_samples{100, 200, 300, 400};

/// What one column of the table comes to.
struct ColumnFigures {
  double sum_of_variances = 0.0;
  double sum_of_bounds = 0.0;
  double efficiency = 0.0;       ///< bound / variance, geometric mean over the parameters
  std::size_t far_off = 0;       ///< estimates with a parameter beyond six standard deviations of the bound
  double largest_bias_sd = 0.0;  ///< of the mean's distance from the truth, in standard errors
  std::size_t most_biased = 0;
};

/// The figures that the report's words and verdicts rest on.
struct Findings {
  // Figs. 1 and 2
  double steepness_before = 0.0;  ///< fall of -log det M per 20 ms, the two steps before 0.18 s
  double steepness_after = 0.0;   ///< the two steps after
  std::size_t d_falls = 0;        ///< steps of length with which the D-optimal criterion falls
  std::size_t a_falls = 0;        ///< the same of the A-optimal one
  double long_force_min_N = 0.0;  ///< smallest and largest peak force of the designs of 0.18 s and more
  double long_force_max_N = 0.0;
  double speed_max_rad_s = 0.0;
  double latest_rise = 0.0;  ///< instant of 90 % of the peak force over the length, the latest of Fig. 1
  double lowest_after_rise = 0.0;    ///< force over its peak after that instant, the lowest of Fig. 1
  double end_speed_max_rad_s = 0.0;  ///< of Fig. 1
  // Table II
  ColumnFigures oem_optimal;
  ColumnFigures pem_optimal;
  ColumnFigures oem_step;
  double methods_variance_ratio = 0.0;  ///< OEM over PEM, geometric mean
  double methods_mean_distance = 0.0;   ///< largest |mean OEM - mean PEM|
  double design_variance_ratio = 0.0;   ///< OEM: step over optimal, geometric mean
  double methods_area_ratio = 0.0;      ///< of Fig. 5's regions, OEM over PEM, geometric mean
  double design_area_ratio = 0.0;       ///< the same, OEM of the step over OEM of the optimal experiment
  double design_bound_ratio = 0.0;      ///< the same of the bounds
  double torque_noise_loss = 0.0;     ///< bound with torque noise over bound without, optimal, geometric mean
  double time_ratio = 0.0;            ///< PEM over OEM
  double mean_torque_noise_Nm = 0.0;  ///< PEM's, of single repeats
  // Figs. 7 and 8
  double brake_longest_rest_s = 0.0;   ///< of any repeat, between approach and release
  std::vector<ReplayFigures> replays;  ///< as sinusoid_replays
  Rest shown_rest;                     ///< the longest of OEM's simulation in the shown repeat
  double sinusoid_error_ratio =
      0.0;                         ///< parameters from sinusoids, median error OEM over PEM, geometric mean
  double filter_force_sd_N = 0.0;  ///< mean half band
  double filter_force_error_N = 0.0;  ///< rms of filtered minus true
  double filter_velocity_error_rad_s = 0.0;
  double velocity_sd_crossing_rad_s = 0.0;  ///< largest where the brake is slower than 20 rad/s
  double velocity_sd_moving_rad_s = 0.0;    ///< mean where it is faster
  double crossing_s = 0.0;                  ///< the true velocity's first zero crossing
  double covered_force = 0.0;               ///< share of rows whose truth is within two standard deviations
  double covered_velocity = 0.0;
  double repeat_s = 0.0;  ///< bench time of one repeat, all told
};

/// Geometric mean over the parameters of a's variances over b's, as printed.
double variance_ratio(const PaperColumn& a, const PaperColumn& b);
double sum_of_variances(const PaperColumn& column);
/// Largest distance of two means, as printed.
double mean_distance(const PaperColumn& a, const PaperColumn& b);

Findings findings_of(const Study& study);

/// The design of this length, or nothing.
const Design* design_of(const std::vector<Design>& designs, std::size_t samples);

}  // namespace clampd::reproduce
