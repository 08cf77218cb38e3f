#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "clampd/statistics/symmetric.hpp"
#include "src/drive/data_check.hpp"

namespace clampd::data_check {
namespace {

std::vector<double> steps_of(std::span<const double> time_s) {
  std::vector<double> steps;
  for (std::size_t i = 1; i < time_s.size(); ++i) steps.push_back(time_s[i] - time_s[i - 1]);
  return steps;
}

/// From which step on rows are missing. Also irregular sampling has a longest step that is usual.
double gap_of(const std::vector<double>& steps) {
  constexpr double kTimesUsual = 5.0;
  return kTimesUsual * quantile(steps, 0.95);
}

/// Root mean square of what a quadratic over time leaves of x.
double left_of_quadratic(std::span<const double> time_s, std::span<const double> x) {
  const auto n = static_cast<Eigen::Index>(x.size());
  Eigen::MatrixXd columns(n, 3);
  Eigen::VectorXd target(n);
  const double middle_s = 0.5 * (time_s.front() + time_s.back()),
               half_s = 0.5 * (time_s.back() - time_s.front());
  for (Eigen::Index k = 0; k < n; ++k) {
    const double u = (time_s[static_cast<std::size_t>(k)] - middle_s) / half_s;
    columns.row(k) << 1.0, u, u * u;
    target[k] = x[static_cast<std::size_t>(k)];
  }
  return statistics::left_of(columns, target).norm() / std::sqrt(static_cast<double>(n));
}

/// How much smoother the motion is if the rows are equally spaced than at their time stamps: the ratio of the
/// residuals of local quadratics, as the median over places that move. Above 1: the stamps scatter and the
/// samples do not.
double smoother_if_regular(const Run& run) {
  constexpr std::size_t kRows = 9, kPlaces = 1000;
  const std::span<const double> x(run.position_rad.empty() ? run.velocity_rad_s : run.position_rad);
  const std::span<const double> time_s(run.time_s);
  const std::size_t stride = std::max<std::size_t>(kRows, run.size() / kPlaces);
  const double step = step_of(x);
  std::vector<double> even(kRows), ratios;
  for (std::size_t k = 0; k < kRows; ++k) even[k] = static_cast<double>(k);
  for (std::size_t i = 0; i + kRows <= run.size(); i += stride) {
    const auto window = x.subspan(i, kRows);
    const auto [least, most] = std::ranges::minmax(window);
    if (most - least < 8.0 * step) continue;  // hardly moves: nothing to be seen
    const double at_stamps = left_of_quadratic(time_s.subspan(i, kRows), window);
    ratios.push_back(at_stamps / std::max(left_of_quadratic(even, window), 1e-9 * (most - least)));
  }
  constexpr std::size_t kEnough = 20;
  return ratios.size() < kEnough ? 1.0 : quantile(std::move(ratios), 0.5);
}

/// Time stamps averaged over their neighbours: equal spacing where the sampling is regular, and its drift
/// kept.
std::vector<double> regular_times(std::span<const double> time_s) {
  constexpr std::size_t kReach = 50;
  const std::size_t n = time_s.size();
  const double gap_s = gap_of(steps_of(time_s));
  std::vector<double> sums(n + 1, 0.0), result(n);
  for (std::size_t i = 0; i < n; ++i) sums[i + 1] = sums[i] + (time_s[i] - time_s.front());
  for (std::size_t begin = 0, end = 0; begin < n; begin = end) {
    for (end = begin + 1; end < n && time_s[end] - time_s[end - 1] <= gap_s;) ++end;
    const double mean_step_s =
        end - begin > 1 ? (time_s[end - 1] - time_s[begin]) / static_cast<double>(end - begin - 1) : 0.0;
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t low = i - std::min(kReach, i - begin), high = std::min(end - 1, i + kReach);
      const double centre = 0.5 * static_cast<double>(low + high);
      const double mean_s =
          time_s.front() + (sums[high + 1] - sums[low]) / static_cast<double>(high + 1 - low);
      result[i] = mean_s + (static_cast<double>(i) - centre) * mean_step_s;
    }
  }
  return result;
}

}  // namespace

void check_gaps(RunCheck& check) {
  const std::vector<double>& time_s = check.run.time_s;
  const std::vector<double> steps = steps_of(time_s);
  const double gap_s = gap_of(steps);
  std::size_t gaps = 0, longest = 0;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    if (steps[i] <= gap_s) continue;
    ++gaps;
    if (gaps == 1 || steps[i] > steps[longest]) longest = i;
  }
  if (gaps == 0) return;
  check.add("time-gap", check.model.columns.time.column, steps[longest], "s", DataSeverity::Note,
            fmt::format("{} in the time stamps, the longest of {:.3g} s at {:.6g} s, where rows usually "
                        "follow each other within "
                        "{:.3g} s: rows are missing. What happened in between is unknown; record without "
                        "gaps, or give the parts as "
                        "files of their own",
                        gaps == 1 ? "a gap" : fmt::format("{} gaps", gaps), steps[longest], time_s[longest],
                        quantile(steps, 0.95)));
}

void check_jitter(RunCheck& check) {
  const std::vector<double> steps = steps_of(check.run.time_s);
  const double step_s = quantile(steps, 0.5);
  // 90 % of a normal variable lie within 3.29 deviations; each step has two stamps.
  const double scatter_s = (quantile(steps, 0.95) - quantile(steps, 0.05)) / 3.29 / std::sqrt(2.0);
  // The position at a stamp that is off by a hundredth of the step is off by a hundredth of what it moves in
  // it: in the acceleration, a second difference, that is some per cent of the speed per step.
  constexpr double kLeast = 0.02;
  if (!(scatter_s > kLeast * step_s)) return;
  const double ratio = smoother_if_regular(check.run);
  // The residual of a regular motion at scattered stamps is many times its noise; half as much again is no
  // chance.
  constexpr double kPlain = 1.5;
  const std::string scatter =
      fmt::format("the time stamps scatter by {:.2g} s ({:.0f} % of the step of {:.4g} s)", scatter_s,
                  100.0 * scatter_s / step_s, step_s);
  const std::string& column = check.model.columns.time.column;
  if (ratio > kPlain) {
    check.run.time_s = regular_times(check.run.time_s);
    check.mended = true;
    check.add("time-jitter", column, scatter_s, "s", DataSeverity::Mended,
              fmt::format("{}, but the motion is {:.1f} times as smooth if the rows are equally spaced: the "
                          "samples are regular and "
                          "their stamps late by chance. The stamps were averaged; record the sampling clock, "
                          "not the time of arrival",
                          scatter, ratio));
  } else {
    check.add(
        "time-jitter", column, scatter_s, "s", DataSeverity::Note,
        fmt::format(
            "{}. {}", scatter,
            ratio < 1.0 / kPlain
                ? "The motion agrees with them: the sampling is irregular, and they are used as they are"
                : "The motion is too slow or too noisy to tell whether the samples scatter, too; "
                  "record the sampling clock, not the time of arrival"));
  }
}

}  // namespace clampd::data_check
