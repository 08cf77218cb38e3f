#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Core>

#include "clampd/statistics/symmetric.hpp"
#include "src/drive/data_check.hpp"

namespace clampd::data_check {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// Coefficients of a cubic through x[first, last) about `at_s`, in units of the half width; nothing where the
/// rows do not determine it.
std::optional<Eigen::Vector4d> local_cubic(std::span<const double> time_s, std::span<const double> x,
                                           std::size_t first, std::size_t last, double at_s,
                                           double half_width_s) {
  Eigen::Matrix4d gram = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  const double origin = x[(first + last) / 2];
  for (std::size_t k = first; k < last; ++k) {
    const double u = (time_s[k] - at_s) / half_width_s;
    const Eigen::Vector4d powers(1.0, u, u * u, u * u * u);
    gram.noalias() += powers * powers.transpose();
    right += (x[k] - origin) * powers;
  }
  const Eigen::LDLT<Eigen::Matrix4d> factor(gram);
  if (factor.info() != Eigen::Success || factor.vectorD().minCoeff() < 1e-9) return std::nullopt;
  Eigen::Vector4d coefficients = factor.solve(right);
  coefficients[0] += origin;
  return coefficients;
}

/// Root mean square of what a cubic over 2 h + 1 rows leaves, as the median over places; small h first sees
/// the noise alone.
double lack_of_fit(std::span<const double> time_s, std::span<const double> x, std::size_t h) {
  constexpr std::size_t kPlaces = 300;
  const std::size_t n = x.size();
  std::vector<double> left;
  const std::size_t stride = std::max<std::size_t>(1, (n - 2 * h) / kPlaces);
  for (std::size_t i = h; i + h < n; i += stride) {
    const double width_s = std::max(time_s[i] - time_s[i - h], time_s[i + h] - time_s[i]);
    const auto cubic = local_cubic(time_s, x, i - h, i + h + 1, time_s[i], width_s);
    if (!cubic) continue;
    double square = 0.0;
    for (std::size_t k = i - h; k <= i + h; ++k) {
      const double u = (time_s[k] - time_s[i]) / width_s;
      square += std::pow(x[k] - cubic->dot(Eigen::Vector4d(1.0, u, u * u, u * u * u)), 2);
    }
    left.push_back(std::sqrt(square / static_cast<double>(2 * h - 3)));
  }
  // The upper quartile: where the motion is liveliest, a window that is too wide shows first.
  return left.empty() ? kNaN : quantile(std::move(left), 0.75);
}

/// The widest window, in rows to each side, over which the reading is a cubic but for its noise.
std::size_t half_width_of(std::span<const double> time_s, std::span<const double> x) {
  const std::size_t n = x.size();
  constexpr std::size_t kLeast = 4, kMost = 256;
  // A third more than the noise: less than that is lost of the motion.
  constexpr double kTolerance = 1.33;
  std::size_t chosen = kLeast;
  if (n < 4 * kLeast) return std::max<std::size_t>(3, n / 5);
  double floor = std::max(lack_of_fit(time_s, x, kLeast), 0.3 * step_of(x));
  for (std::size_t h = 2 * kLeast; h <= kMost && 8 * h < n; h *= 2) {
    const double left = lack_of_fit(time_s, x, h);
    if (!(left <= kTolerance * floor)) break;
    floor = std::max(floor, left / kTolerance);
    chosen = h;
  }
  return chosen;
}

}  // namespace

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return kNaN;
  const auto at = values.begin() +
                  static_cast<std::ptrdiff_t>(std::lround(share * static_cast<double>(values.size() - 1)));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

double median_of_steps(std::span<const double> time_s) {
  std::vector<double> steps;
  steps.reserve(time_s.size());
  for (std::size_t i = 1; i < time_s.size(); ++i) steps.push_back(time_s[i] - time_s[i - 1]);
  return quantile(std::move(steps), 0.5);
}

double step_of(std::span<const double> values) {
  double largest = 0.0;
  for (const double value : values) largest = std::max(largest, std::abs(value));
  std::vector<double> changes;
  for (std::size_t i = 1; i < values.size(); ++i)
    if (const double change = std::abs(values[i] - values[i - 1]); change > 1e-12 * largest)
      changes.push_back(change);
  // Not the very smallest: a single reading that was computed otherwise is no step.
  return changes.empty() ? 0.0 : quantile(std::move(changes), 0.02);
}

double travel_of(const std::vector<double>& position) {
  return quantile(position, 0.98) - quantile(position, 0.02);
}

double noise_of(std::span<const double> values) {
  std::vector<double> second;
  for (std::size_t i = 2; i < values.size(); ++i)
    second.push_back(std::abs(values[i] - 2.0 * values[i - 1] + values[i - 2]));
  // Of a normal variable the median magnitude is 0.6745 deviations; a second difference has sqrt(6) times the
  // deviation.
  return second.empty() ? 0.0 : quantile(std::move(second), 0.5) / (0.6745 * std::sqrt(6.0));
}

std::vector<double> differences(std::span<const double> time_s, std::span<const double> values) {
  const std::size_t n = values.size();
  std::vector<double> result(n, 0.0);
  for (std::size_t i = 0; i < n && n > 1; ++i) {
    const std::size_t before = i > 0 ? i - 1 : i, after = i + 1 < n ? i + 1 : i;
    result[i] = (values[after] - values[before]) / (time_s[after] - time_s[before]);
  }
  return result;
}

std::vector<double> velocity_of(const Run& run) {
  return run.position_rad.empty() ? run.velocity_rad_s : differences(run.time_s, run.position_rad);
}

double interpolate(std::span<const double> time_s, std::span<const double> values, double at_s) {
  const auto after =
      static_cast<std::size_t>(std::upper_bound(time_s.begin(), time_s.end(), at_s) - time_s.begin());
  if (after == 0) return values.front();
  if (after == time_s.size()) return values.back();
  const double share = (at_s - time_s[after - 1]) / (time_s[after] - time_s[after - 1]);
  return values[after - 1] + share * (values[after] - values[after - 1]);
}

SmoothMotion smooth_motion(const Run& run, std::size_t most) {
  const std::span<const double> time_s(run.time_s);
  const bool position = !run.position_rad.empty();
  const std::span<const double> x(position ? run.position_rad : run.velocity_rad_s);
  const std::size_t n = run.size(), h = half_width_of(time_s, x);
  SmoothMotion motion;
  motion.half_width_s = static_cast<double>(h) * median_of_steps(time_s);
  const std::size_t stride = std::max<std::size_t>(std::max<std::size_t>(1, h / 2), n / most);
  for (std::size_t i = h; i + h < n; i += stride) {
    const double width_s = std::max(time_s[i] - time_s[i - h], time_s[i + h] - time_s[i]);
    if (width_s > 2.5 * motion.half_width_s) continue;  // a gap
    const auto cubic = local_cubic(time_s, x, i - h, i + h + 1, time_s[i], width_s);
    if (!cubic) continue;
    motion.time_s.push_back(time_s[i]);
    motion.position.push_back(position ? (*cubic)[0] : 0.0);
    motion.velocity.push_back(position ? (*cubic)[1] / width_s : (*cubic)[0]);
    motion.acceleration.push_back(position ? 2.0 * (*cubic)[2] / (width_s * width_s) : (*cubic)[1] / width_s);
  }
  motion.torque = smooth_torque(run, motion, 0.0);
  return motion;
}

std::vector<double> smooth_torque(const Run& run, const SmoothMotion& at, double shift_s) {
  std::vector<double> torque;
  std::size_t first = 0;
  // The cubic's value has about the bandwidth of a mean over half of its window.
  const double width_s = 0.5 * at.half_width_s;
  for (const double time_s : at.time_s) {
    const double from_s = time_s + shift_s - width_s, to_s = time_s + shift_s + width_s;
    while (first < run.size() && run.time_s[first] < from_s) ++first;
    double sum = 0.0;
    std::size_t count = 0;
    for (std::size_t k = first; k < run.size() && run.time_s[k] <= to_s; ++k, ++count)
      sum += run.torque_Nm[k];
    torque.push_back(count > 2 ? sum / static_cast<double>(count)
                               : interpolate(run.time_s, run.torque_Nm, time_s + shift_s));
  }
  return torque;
}

}  // namespace clampd::data_check
