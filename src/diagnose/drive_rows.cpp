#include "src/diagnose/drive_rows.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include "clampd/statistics/symmetric.hpp"

namespace clampd::drive {

struct RowsBuilder {
  static void add(DriveRows& rows, std::size_t first, std::vector<double> weights) {
    rows.rows_.push_back({first, std::move(weights)});
  }
};

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::size_t kLeastSamples = 20;

double quantile(std::vector<double> values, double share) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

double median_step(std::span<const double> time_s) {
  std::vector<double> steps;
  for (std::size_t i = 1; i < time_s.size(); ++i) steps.push_back(time_s[i] - time_s[i - 1]);
  return quantile(std::move(steps), 0.5);
}

struct Smoothed {
  std::vector<double> value, first, second;
  double noise = 0.0;        ///< standard deviation of a reading
  double first_noise = 0.0;  ///< of the first derivative
};

/// Local polynomials of the given degree under a tricube window of `half_width_s`.
Smoothed smooth(std::span<const double> time_s, std::span<const double> x, int degree, double half_width_s) {
  const std::size_t n = x.size();
  Smoothed result;
  result.value.resize(n);
  result.first.resize(n);
  result.second.assign(n, 0.0);
  const int terms = degree + 1;
  std::size_t low = 0;
  std::size_t high = 0;
  double square = 0.0;
  std::vector<double> derivative_factors;
  for (std::size_t i = 0; i < n; ++i) {
    while (time_s[low] <= time_s[i] - half_width_s) ++low;
    while (high < n && time_s[high] < time_s[i] + half_width_s) ++high;
    // Gaps and ends of a record: as many samples as the polynomial needs, and some.
    const std::size_t least = static_cast<std::size_t>(terms) + 3;
    std::size_t from = low;
    std::size_t to = high;
    double width = half_width_s;
    while (to - from < least) {
      if (from > 0) --from;
      if (to < n) ++to;
      width = 1.01 * std::max(time_s[i] - time_s[from], time_s[to - 1] - time_s[i]);
    }
    Eigen::Matrix4d gram = Eigen::Matrix4d::Zero();
    Eigen::Vector4d right = Eigen::Vector4d::Zero();
    double leverage = 0.0;
    for (std::size_t k = from; k < to; ++k) {
      const double u = (time_s[k] - time_s[i]) / width;
      const double c = 1.0 - std::abs(u * u * u);
      const double weight = c * c * c;
      if (k == i) leverage = weight;
      const Eigen::Vector4d powers(1.0, u, u * u, u * u * u);
      gram.noalias() += weight * powers * powers.transpose();
      right += weight * (x[k] - x[i]) * powers;
    }
    const Eigen::MatrixXd inverse = statistics::SymmetricFactor(gram.topLeftCorner(terms, terms)).inverse();
    const Eigen::VectorXd coefficients = inverse * right.head(terms);
    result.value[i] = x[i] + coefficients[0];
    result.first[i] = coefficients[1] / width;
    if (degree >= 2) result.second[i] = 2.0 * coefficients[2] / (width * width);
    const double free = std::max(0.1, 1.0 - leverage * inverse(0, 0));
    square += coefficients[0] * coefficients[0] / free;
    derivative_factors.push_back(std::sqrt(inverse(1, 1)) / width);
  }
  result.noise = std::sqrt(square / static_cast<double>(n));
  result.first_noise = result.noise * quantile(std::move(derivative_factors), 0.5);
  return result;
}

/// Of a Gaussian with -3 dB at the cut-off.
double gaussian_sd_s(double cut_off_Hz) {
  return std::sqrt(std::log(2.0)) / (2.0 * M_PI * cut_off_Hz);
}

/// Share of a time each sample stands for.
double cell_s(std::span<const double> time_s, std::size_t i) {
  const std::size_t n = time_s.size();
  const double before = i > 0 ? time_s[i] - time_s[i - 1] : time_s[1] - time_s[0];
  const double after = i + 1 < n ? time_s[i + 1] - time_s[i] : time_s[n - 1] - time_s[n - 2];
  return 0.5 * (before + after);
}

/// Weights of a Gaussian about `at_s`; sum 1.
std::vector<double> kernel(std::span<const double> time_s, double at_s, double sd_s, std::size_t& first) {
  first = static_cast<std::size_t>(std::lower_bound(time_s.begin(), time_s.end(), at_s - 4.0 * sd_s) -
                                   time_s.begin());
  std::vector<double> weights;
  double sum = 0.0;
  for (std::size_t i = first; i < time_s.size() && time_s[i] <= at_s + 4.0 * sd_s; ++i) {
    const double u = (time_s[i] - at_s) / sd_s;
    weights.push_back(std::exp(-0.5 * u * u) * cell_s(time_s, i));
    sum += weights.back();
  }
  for (double& weight : weights) weight /= sum;
  return weights;
}

/// The lowest cut-off that leaves all but this share of the torque's power, noise aside.
double chosen_cut_off_Hz(const Run& run) {
  constexpr double kLostShare = 0.001;
  const std::span<const double> time_s(run.time_s);
  const std::size_t n = run.size();
  const double highest_Hz = 0.2 / median_step(time_s);
  double mean = std::accumulate(run.torque_Nm.begin(), run.torque_Nm.end(), 0.0) / static_cast<double>(n);
  double power = 0.0;
  double roughness = 0.0;
  for (std::size_t i = 0; i < n; ++i) power += std::pow(run.torque_Nm[i] - mean, 2);
  for (std::size_t i = 2; i < n; ++i)
    roughness += std::pow(run.torque_Nm[i] - 2.0 * run.torque_Nm[i - 1] + run.torque_Nm[i - 2], 2) / 6.0;
  double chosen_Hz = highest_Hz;
  for (double cut_off_Hz = highest_Hz / 1.25; cut_off_Hz * (time_s[n - 1] - time_s[0]) > 40.0;
       cut_off_Hz /= 1.25) {
    const double sd_s = gaussian_sd_s(cut_off_Hz);
    const std::size_t stride = std::max<std::size_t>(1, n / 2000);
    double lost = 0.0;
    for (std::size_t i = 0; i < n; i += stride) {
      std::size_t first = 0;
      const std::vector<double> weights = kernel(time_s, time_s[i], sd_s, first);
      double value = 0.0;
      for (std::size_t k = 0; k < weights.size(); ++k) value += weights[k] * run.torque_Nm[first + k];
      lost += std::pow(run.torque_Nm[i] - value, 2) * static_cast<double>(stride);
    }
    if (lost - roughness > kLostShare * power) break;
    chosen_Hz = cut_off_Hz;
  }
  return chosen_Hz;
}

Result<void> check(const Run& run, const DriveModel& model) {
  const auto bad = [&](std::string_view what) { return failure(fmt::format("{}: {}", run.name, what)); };
  if (run.size() < kLeastSamples)
    return bad(fmt::format("{} rows are too few; a drive's run needs {}", run.size(), kLeastSamples));
  if (run.torque_Nm.size() != run.size()) return bad("no torque; name its column in the model file");
  const bool position = run.position_rad.size() == run.size();
  const bool velocity = run.velocity_rad_s.size() == run.size();
  if (!position && !velocity) return bad("neither position nor velocity; name a column in the model file");
  if (model.steady && !velocity && !position) return bad("no velocity");
  return {};
}

DriveMotion motion_of(const Run& run, double cut_off_Hz) {
  // Wider than the rows' filter, so that what little it attenuates is of no account there.
  const double half_width_s = std::max(1.0 / (5.0 * cut_off_Hz), 3.5 * median_step(run.time_s));
  DriveMotion motion;
  motion.time_s = run.time_s;
  motion.torque = run.torque_Nm;
  double noise = 0.0;
  if (!run.position_rad.empty()) {
    Smoothed position = smooth(run.time_s, run.position_rad, 3, half_width_s);
    motion.position = std::move(position.value);
    motion.velocity = std::move(position.first);
    motion.acceleration = std::move(position.second);
    noise = position.first_noise;
  } else {
    Smoothed velocity = smooth(run.time_s, run.velocity_rad_s, 2, half_width_s);
    motion.velocity = std::move(velocity.value);
    motion.acceleration = std::move(velocity.first);
    noise = velocity.noise;
    motion.position.assign(run.size(), 0.0);
    for (std::size_t i = 1; i < run.size(); ++i)
      motion.position[i] = motion.position[i - 1] + 0.5 *
                                                        (run.velocity_rad_s[i] + run.velocity_rad_s[i - 1]) *
                                                        (run.time_s[i] - run.time_s[i - 1]);
  }
  std::vector<double> speeds;
  for (const double v : motion.velocity) speeds.push_back(std::abs(v));
  const double floor = std::max(3.0 * noise, 0.002 * quantile(speeds, 0.99));
  double last_sign = 0.0;
  double reversal = std::numeric_limits<double>::quiet_NaN();
  for (std::size_t i = 0; i < run.size(); ++i) {
    const double v = motion.velocity[i];
    const double sign = std::abs(v) <= floor ? 0.0 : std::copysign(1.0, v);
    if (sign != 0.0) {
      if (last_sign == -sign) reversal = motion.position[i];
      last_sign = sign;
    }
    motion.sign.push_back(sign);
    motion.travel.push_back(std::isnan(reversal) ? kInfinity : std::abs(motion.position[i] - reversal));
  }
  return motion;
}

void fill(DriveRows& rows) {
  rows.time_s = rows.filtered(rows.motion.time_s);
  rows.torque = rows.filtered(rows.motion.torque);
  rows.position = rows.filtered(rows.motion.position);
  rows.velocity = rows.filtered(rows.motion.velocity);
  rows.acceleration = rows.filtered(rows.motion.acceleration);
  rows.sign = rows.filtered(rows.motion.sign);
}

/// Around each sample: half of the time the command before it still acts.
void center_held(std::vector<double>& torque) {
  for (std::size_t i = torque.size() - 1; i > 0; --i) torque[i] = 0.5 * (torque[i] + torque[i - 1]);
}

DriveRows rows_of(const Run& run, const DriveModel& model, double cut_off_Hz) {
  constexpr double kMaxStandstill = 0.1;
  DriveRows rows;
  rows.name = run.name;
  rows.motion = motion_of(run, cut_off_Hz);
  if (model.torque_held) center_held(rows.motion.torque);
  const double sd_s = gaussian_sd_s(cut_off_Hz);
  const double margin_s = 3.0 * sd_s + 1.0 / (3.0 * cut_off_Hz);
  const double step_s = 0.4 / cut_off_Hz;
  for (double at_s = run.time_s.front() + margin_s; at_s <= run.time_s.back() - margin_s; at_s += step_s) {
    std::size_t first = 0;
    std::vector<double> weights = kernel(run.time_s, at_s, sd_s, first);
    double standstill = 0.0;
    for (std::size_t k = 0; k < weights.size(); ++k)
      if (rows.motion.sign[first + k] == 0.0) standstill += weights[k];
    if (weights.empty() || standstill > kMaxStandstill) continue;
    RowsBuilder::add(rows, first, std::move(weights));
  }
  fill(rows);
  return rows;
}

DriveRows steady_row_of(const Run& run) {
  DriveRows rows;
  rows.name = run.name;
  std::vector<double> velocity = run.velocity_rad_s;
  if (velocity.empty())
    velocity = {(run.position_rad.back() - run.position_rad.front()) /
                (run.time_s.back() - run.time_s.front())};
  const double v = quantile(velocity, 0.5);
  rows.motion.time_s = {0.5 * (run.time_s.front() + run.time_s.back())};
  rows.motion.torque = {quantile(run.torque_Nm, 0.5)};
  rows.motion.velocity = {v};
  rows.motion.acceleration = {0.0};
  rows.motion.position = {0.0};
  rows.motion.sign = {v == 0.0 ? 0.0 : std::copysign(1.0, v)};
  rows.motion.travel = {kInfinity};
  if (v != 0.0) RowsBuilder::add(rows, 0, {1.0});
  fill(rows);
  return rows;
}

}  // namespace

Eigen::VectorXd DriveRows::filtered(std::span<const double> samples) const {
  Eigen::VectorXd result(static_cast<Eigen::Index>(rows_.size()));
  for (std::size_t r = 0; r < rows_.size(); ++r) {
    double sum = 0.0;
    for (std::size_t k = 0; k < rows_[r].weights.size(); ++k)
      sum += rows_[r].weights[k] * samples[rows_[r].first + k];
    result[static_cast<Eigen::Index>(r)] = sum;
  }
  return result;
}

Result<DriveData> prepare(std::span<const Run> runs, const DriveModel& model, double cut_off_Hz) {
  if (runs.empty()) return failure("no run to diagnose");
  for (const Run& run : runs)
    if (const Result<void> checked = check(run, model); !checked) return tl::unexpected(checked.error());
  DriveData data;
  data.position_absolute = !model.steady && !runs.front().position_rad.empty();
  data.cut_off_Hz = cut_off_Hz;
  if (model.steady) {
    for (const Run& run : runs) data.runs.push_back(steady_row_of(run));
  } else {
    if (std::isnan(cut_off_Hz)) cut_off_Hz = model.cut_off_Hz;
    if (std::isnan(cut_off_Hz)) {
      cut_off_Hz = 0.0;
      for (const Run& run : runs) cut_off_Hz = std::max(cut_off_Hz, chosen_cut_off_Hz(run));
    }
    data.cut_off_Hz = cut_off_Hz;
    for (const Run& run : runs)
      data.runs.push_back(rows_of(run, model, std::min(cut_off_Hz, 0.2 / median_step(run.time_s))));
  }
  for (const DriveRows& run : data.runs)
    if (run.size() == 0) data.notices.push_back(fmt::format("{}: the drive does not move in it", run.name));
  std::erase_if(data.runs, [](const DriveRows& run) { return run.size() == 0; });
  if (data.runs.empty()) return failure("the drive stands still in every run; nothing can be told of it");
  return data;
}

}  // namespace clampd::drive
