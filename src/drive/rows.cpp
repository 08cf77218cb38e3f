#include "src/drive/rows.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>

#include <fmt/format.h>
#include <Eigen/LU>

#include "src/drive/data_check.hpp"

namespace clampd::drive {

struct RowsBuilder {
  /// Velocity and acceleration from the readings themselves.
  template <class Derivatives>
  static void set_motion(DriveRows& rows, const Run& run, const Derivatives& derivatives) {
    const bool position = !run.position_rad.empty();
    const std::span<const double> time_s(rows.motion.time_s),
        x(position ? run.position_rad : run.velocity_rad_s);
    for (std::size_t r = 0; r < rows.rows_.size(); ++r) {
      const DriveRows::Row& row = rows.rows_[r];
      if (row.weights.size() < 4) continue;
      const std::array<double, 2> both =
          derivatives(time_s, x, row.at_s, rows.filter_sd_s_, row.first, row.weights);
      if (!std::isfinite(both[0]) || !std::isfinite(both[1])) continue;
      const auto i = static_cast<Eigen::Index>(r);
      if (position) rows.velocity[i] = both[0];
      rows.acceleration[i] = position ? both[1] : both[0];
    }
    if (!position) rows.velocity = rows.filtered(run.velocity_rad_s);
  }
  static void add(DriveRows& rows, double at_s, std::size_t first, std::vector<double> weights) {
    rows.rows_.push_back({at_s, first, std::move(weights)});
  }
  static void set_filter(DriveRows& rows, double sd_s) {
    rows.filter_sd_s_ = sd_s;
    double sum = 0.0;
    for (const DriveRows::Row& row : rows.rows_)
      for (const double weight : row.weights) sum += weight * weight;
    if (!rows.rows_.empty()) rows.sum_of_squared_weights = sum / static_cast<double>(rows.rows_.size());
  }
};

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// More rows than this tell a model of some twenty coefficients nothing new; the cut-off is lowered instead.
constexpr double kMostRows = 40'000.0;
constexpr double kHighestCutOff =
    0.12;  ///< of the sampling rate: the filter is then a sample wide, and its derivatives are true
constexpr double kSamplesPerRow = 12.0;  ///< more are averaged first
constexpr double kAccelerationNoise =
    0.01;  ///< of the torque, root mean square, what the noise of the acceleration may make of it

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
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

/// Standard deviation of white noise in readings at any times: what they differ by from the polynomial
/// through `beside` neighbours on either side, which smooth motion hardly does. The largest hundredth, as by
/// spikes, is cut to size.
double white_noise(std::span<const double> time_s, std::span<const double> x, std::size_t beside) {
  constexpr std::size_t kMost = 20'000;
  const std::size_t n = x.size();
  if (n < 4 * beside) return 0.0;
  const std::size_t stride = std::max<std::size_t>(1, n / kMost);
  std::vector<double> deviations;
  for (std::size_t i = beside; i + beside < n; i += stride) {
    double deviation = x[i], square = 1.0;
    for (std::size_t j = i - beside; j <= i + beside; ++j) {
      if (j == i) continue;
      double weight = 1.0;
      for (std::size_t k = i - beside; k <= i + beside; ++k)
        if (k != i && k != j) weight *= (time_s[i] - time_s[k]) / (time_s[j] - time_s[k]);
      deviation -= weight * x[j];
      square += weight * weight;
    }
    deviations.push_back(std::abs(deviation) / std::sqrt(square));
  }
  const double most = quantile(deviations, 0.99);
  double square = 0.0;
  for (const double each : deviations) square += std::pow(std::min(each, most), 2);
  return std::sqrt(square / static_cast<double>(deviations.size()));
}

struct Smoothed {
  std::vector<double> value, first, second;
  double first_noise = 0.0;  ///< standard deviation of the first derivative
  double value_noise = 0.0;
};

/// Local polynomials of degree `degree` (2 or 3) under a tricube window of `half_width_s`.
template <int degree>
Smoothed smooth(std::span<const double> time_s, std::span<const double> x, double half_width_s) {
  constexpr int kTerms = degree + 1;
  using Powers = Eigen::Matrix<double, kTerms, 1>;
  using Gram = Eigen::Matrix<double, kTerms, kTerms>;
  const std::size_t n = x.size();
  Smoothed result;
  result.value.resize(n);
  result.first.resize(n);
  result.second.resize(n);
  std::size_t low = 0, high = 0;
  std::vector<double> deviations(n), derivative_factors(n);
  for (std::size_t i = 0; i < n; ++i) {
    while (time_s[low] <= time_s[i] - half_width_s) ++low;
    while (high < n && time_s[high] < time_s[i] + half_width_s) ++high;
    // Gaps and ends of a record: as many samples as the polynomial needs, and some.
    std::size_t from = low, to = high;
    double width = half_width_s;
    while (to - from < static_cast<std::size_t>(kTerms) + 3) {
      if (from > 0) --from;
      if (to < n) ++to;
      width = 1.01 * std::max(time_s[i] - time_s[from], time_s[to - 1] - time_s[i]);
    }
    Gram gram = Gram::Zero();
    Powers right = Powers::Zero();
    double leverage = 0.0;
    for (std::size_t k = from; k < to; ++k) {
      const double u = (time_s[k] - time_s[i]) / width;
      const double c = 1.0 - std::abs(u * u * u);
      const double weight = c * c * c;
      if (k == i) leverage = weight;
      Powers powers;
      powers[0] = 1.0;
      for (int p = 1; p < kTerms; ++p) powers[p] = powers[p - 1] * u;
      gram.noalias() += weight * powers * powers.transpose();
      right += weight * (x[k] - x[i]) * powers;
    }
    const Gram inverse = gram.inverse();
    const Powers coefficients = inverse * right;
    result.value[i] = x[i] + coefficients[0];
    result.first[i] = coefficients[1] / width;
    result.second[i] = 2.0 * coefficients[2] / (width * width);
    deviations[i] = std::abs(coefficients[0]) / std::sqrt(std::max(0.1, 1.0 - leverage * inverse(0, 0)));
    derivative_factors[i] = std::sqrt(std::max(0.0, inverse(1, 1))) / width;
  }
  // By a median, so that single bad samples make no standstill of a motion; by the mean of the smaller nine
  // tenths where an encoder's step leaves most at zero.
  double noise = 1.4826 * quantile(deviations, 0.5);
  const double most = quantile(deviations, 0.9);
  double square = 0.0;
  for (const double each : deviations) square += std::pow(std::min(each, most), 2);
  noise = std::max(noise, std::sqrt(square / static_cast<double>(n)));
  result.value_noise = noise;
  result.first_noise = noise * quantile(std::move(derivative_factors), 0.5);
  return result;
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
double torque_bandwidth_Hz(const Run& run) {
  constexpr double kLostShare = 0.001;
  const std::span<const double> time_s(run.time_s);
  const std::size_t n = run.size();
  const double highest_Hz = kHighestCutOff / median_step(time_s);
  const double mean =
      std::accumulate(run.torque_Nm.begin(), run.torque_Nm.end(), 0.0) / static_cast<double>(n);
  double power = 0.0;
  for (const double torque : run.torque_Nm) power += std::pow(torque - mean, 2);
  const double noise = static_cast<double>(n) * std::pow(white_noise(run.time_s, run.torque_Nm, 1), 2);
  double chosen_Hz = highest_Hz;
  for (double cut_off_Hz = highest_Hz / 1.25; cut_off_Hz * (time_s[n - 1] - time_s[0]) > 40.0;
       cut_off_Hz /= 1.25) {
    const double sd_s = gaussian_sd_s(cut_off_Hz);
    const std::size_t stride = std::max<std::size_t>(1, n / 1000);
    double lost = 0.0;
    for (std::size_t i = 0; i < n; i += stride) {
      std::size_t first = 0;
      const std::vector<double> weights = kernel(time_s, time_s[i], sd_s, first);
      double value = 0.0;
      for (std::size_t k = 0; k < weights.size(); ++k) value += weights[k] * run.torque_Nm[first + k];
      lost += std::pow(run.torque_Nm[i] - value, 2) * static_cast<double>(stride);
    }
    if (lost - noise > kLostShare * power) break;
    chosen_Hz = cut_off_Hz;
  }
  return chosen_Hz;
}

Result<void> check(const Run& run, const DriveModel& model) {
  const auto bad = [&](std::string_view what) { return failure(fmt::format("{}: {}", run.name, what)); };
  if (run.size() < kLeastSamples)
    return bad(fmt::format("{} rows are too few; a drive's run needs {}", run.size(), kLeastSamples));
  if (run.torque_Nm.size() != run.size())
    return bad(fmt::format("no {}; name its column in the model file", model.effort()));
  const bool position = run.position_rad.size() == run.size();
  const bool velocity = run.velocity_rad_s.size() == run.size();
  if (!position && !velocity) return bad("neither position nor velocity; name a column in the model file");
  for (std::size_t c = 0; c < model.regressors.size(); ++c)
    if (c >= run.others.size() || run.others[c].values.size() != run.size())
      return bad(fmt::format("no column for the regressor {}", model.regressors[c].name));
  if (model.load_position && (!position || run.others.size() != model.regressors.size() + 1))
    return bad("no load position beside the motor's");
  const auto finite = [](const std::vector<double>& values) {
    return std::ranges::all_of(values, [](double value) { return std::isfinite(value); });
  };
  if (!finite(run.time_s) || !finite(run.torque_Nm) || !finite(run.position_rad) ||
      !finite(run.velocity_rad_s))
    return bad("a reading is not a finite number");
  return {};
}

/// Around each recorded sample, before any are averaged: half of the time the command before it still acts.
void center_held(std::vector<double>& torque) {
  for (std::size_t i = torque.size() - 1; i > 0; --i) torque[i] = 0.5 * (torque[i] + torque[i - 1]);
}

/// Averages of `count` samples each, of a torque that is a held command around each recorded sample.
Run averaged(const Run& run, std::size_t count, bool torque_held) {
  std::vector<double> torque = run.torque_Nm;
  if (torque_held) center_held(torque);
  if (count <= 1) {
    Run result = run;
    result.torque_Nm = std::move(torque);
    return result;
  }
  const auto means = [&](const std::vector<double>& values) {
    std::vector<double> result;
    result.reserve(values.size() / count + 1);
    for (std::size_t i = 0; i + count <= values.size(); i += count)
      result.push_back(std::accumulate(values.begin() + static_cast<std::ptrdiff_t>(i),
                                       values.begin() + static_cast<std::ptrdiff_t>(i + count), 0.0) /
                       static_cast<double>(count));
    return result;
  };
  Run result;
  result.name = run.name;
  result.time_s = means(run.time_s);
  result.torque_Nm = means(torque);
  result.position_rad = means(run.position_rad);
  result.velocity_rad_s = means(run.velocity_rad_s);
  result.drive_enabled = means(run.drive_enabled);
  for (const RunColumn& other : run.others) result.others.push_back({other.name, means(other.values)});
  return result;
}

DriveMotion motion_of(const Run& run, double cut_off_Hz, double& slow_speed) {
  // Narrower than the rows' filter, so that what little it attenuates is of no account there.
  const double half_width_s = std::max(1.0 / (5.0 * cut_off_Hz), 3.5 * median_step(run.time_s));
  DriveMotion motion;
  motion.time_s = run.time_s;
  for (double& time_s : motion.time_s) time_s -= run.time_s.front();
  motion.torque = run.torque_Nm;
  double noise = 0.0;
  if (!run.position_rad.empty()) {
    Smoothed position = smooth<3>(motion.time_s, run.position_rad, half_width_s);
    motion.position = std::move(position.value);
    motion.velocity = std::move(position.first);
    motion.acceleration = std::move(position.second);
    noise = position.first_noise;
  } else {
    Smoothed velocity = smooth<2>(motion.time_s, run.velocity_rad_s, half_width_s);
    motion.velocity = std::move(velocity.value);
    motion.acceleration = std::move(velocity.first);
    noise = velocity.value_noise;
    motion.position.assign(run.size(), 0.0);
    for (std::size_t i = 1; i < run.size(); ++i)
      motion.position[i] = motion.position[i - 1] + 0.5 *
                                                        (run.velocity_rad_s[i] + run.velocity_rad_s[i - 1]) *
                                                        (run.time_s[i] - run.time_s[i - 1]);
  }
  for (const RunColumn& other : run.others) motion.columns.push_back(other.values);
  std::vector<double> speeds;
  for (const double v : motion.velocity) speeds.push_back(std::abs(v));
  const double floor =
      std::max(std::min(3.0 * noise, 0.3 * quantile(speeds, 0.9)), 0.002 * quantile(speeds, 0.99));
  slow_speed = std::max(slow_speed, floor);
  double last_sign = 0.0;
  double reversal = std::numeric_limits<double>::quiet_NaN();
  for (std::size_t i = 0; i < run.size(); ++i) {
    const double v = motion.velocity[i];
    const double sign = std::abs(v) <= floor ? 0.0 : std::copysign(1.0, v);
    if (sign != 0.0) {
      if (last_sign == -sign) reversal = motion.position[i];
      last_sign = sign;
    }
    motion.direction.push_back(sign);
    motion.travel.push_back(std::isnan(reversal) ? kInfinity : std::abs(motion.position[i] - reversal));
  }
  return motion;
}

/// Gaussian-filtered first and second derivative at a row, by a local polynomial of second degree under the
/// row's own weights: where samples are even, exactly what the filter that the torque goes through makes of
/// the true derivatives.
std::array<double, 2> derivatives(std::span<const double> time_s, std::span<const double> x, double at_s,
                                  double sd_s, std::size_t first, std::span<const double> weights) {
  Eigen::Matrix3d gram = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < weights.size(); ++k) {
    const double u = (time_s[first + k] - at_s) / sd_s;
    const Eigen::Vector3d powers(1.0, u, u * u);
    gram.noalias() += weights[k] * powers * powers.transpose();
    right += weights[k] * (x[first + k] - x[first]) * powers;
  }
  const Eigen::Vector3d coefficients = gram.inverse() * right;
  return {coefficients[1] / sd_s, 2.0 * coefficients[2] / (sd_s * sd_s)};
}

void fill(DriveRows& rows) {
  rows.time_s = rows.filtered(rows.motion.time_s);
  rows.torque = rows.filtered(rows.motion.torque);
  rows.position = rows.filtered(rows.motion.position);
  rows.velocity = rows.filtered(rows.motion.velocity);
  rows.acceleration = rows.filtered(rows.motion.acceleration);
  rows.direction = rows.filtered(rows.motion.direction);
  std::vector<double> travel = rows.motion.travel;
  for (double& each : travel) each = std::min(each, 1e30);
  rows.travel = rows.filtered(travel);
}

/// Where a row's window holds standstill, a gap or the drive off, it is left out.
enum class RowUse { Used, Standstill, Gap, DriveOff, Reversal };
constexpr std::size_t kRowUses = 5;

RowUse use_of(const DriveRows& rows, const Run& run, std::size_t first, const std::vector<double>& weights,
              double step_s) {
  constexpr double kMaxStandstill = 0.1, kMaxReversal = 0.03;
  if (weights.size() < 2) return RowUse::Gap;
  double standstill = 0.0, forward = 0.0, backward = 0.0;
  for (std::size_t k = 0; k < weights.size(); ++k) {
    const double direction = rows.motion.direction[first + k];
    (direction == 0.0 ? standstill : direction > 0.0 ? forward : backward) += weights[k];
    if (k > 0 && run.time_s[first + k] - run.time_s[first + k - 1] > 2.0 * step_s) return RowUse::Gap;
    if (!run.drive_enabled.empty() && run.drive_enabled[first + k] < 1.0) return RowUse::DriveOff;
  }
  if (standstill > kMaxStandstill) return RowUse::Standstill;
  // For how long the drive sticks between two directions, no reading tells.
  return std::min(forward, backward) + standstill > kMaxReversal ? RowUse::Reversal : RowUse::Used;
}

/// In which the past is forgotten, but for a hundredth; and the share of a run that may go for it.
constexpr double kTimeConstants = 5.0, kMostOfARun = 0.03;

DriveRows rows_of(const Run& run, double cut_off_Hz, DriveData& data, std::array<double, kRowUses>& seconds) {
  DriveRows rows;
  rows.name = run.name;
  rows.motion = motion_of(run, cut_off_Hz, data.slow_speed);
  const std::span<const double> time_s(rows.motion.time_s);
  const double sd_s = gaussian_sd_s(cut_off_Hz);
  const double margin_s = 3.0 * sd_s + 1.0 / (3.0 * cut_off_Hz);
  // What a torque that is late does at first was asked for before the record began.
  const double past_s = std::min(kTimeConstants * std::abs(data.delay_s), kMostOfARun * time_s.back());
  const double step_s = kRowsPerCutOff / cut_off_Hz;
  const double longest_gap_s = std::max(step_s, 3.0 * median_step(time_s));
  for (double at_s = margin_s + past_s; at_s <= time_s.back() - margin_s; at_s += step_s) {
    std::size_t first = 0;
    std::vector<double> weights = kernel(time_s, at_s, sd_s, first);
    const RowUse use = use_of(rows, run, first, weights, longest_gap_s);
    seconds[static_cast<std::size_t>(use)] += step_s;
    if (use == RowUse::Used || (use == RowUse::Reversal && data.keeps_reversals))
      RowsBuilder::add(rows, at_s, first, std::move(weights));
  }
  RowsBuilder::set_filter(rows, sd_s);
  fill(rows);
  RowsBuilder::set_motion(rows, run, derivatives);
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
  rows.motion.time_s = {0.5 * (run.time_s.back() - run.time_s.front())};
  rows.motion.torque = {quantile(run.torque_Nm, 0.5)};
  rows.motion.velocity = {v};
  rows.motion.acceleration = {0.0};
  rows.motion.position = {0.0};
  rows.motion.direction = {v == 0.0 ? 0.0 : std::copysign(1.0, v)};
  rows.motion.travel = {kInfinity};
  for (const RunColumn& other : run.others) rows.motion.columns.push_back({quantile(other.values, 0.5)});
  if (v != 0.0) RowsBuilder::add(rows, 0.0, 0, {1.0});
  fill(rows);
  return rows;
}

/// Of white noise in position or velocity, what a row's acceleration holds after differentiation and the
/// rows' filter.
double acceleration_noise(const Run& run, double cut_off_Hz) {
  const double step_s = median_step(run.time_s);
  const double sd_s = gaussian_sd_s(cut_off_Hz);
  if (!run.position_rad.empty())
    return white_noise(run.time_s, run.position_rad, 3) *
           std::sqrt(step_s * 3.0 / (8.0 * std::sqrt(M_PI)) / std::pow(sd_s, 5));
  return white_noise(run.time_s, run.velocity_rad_s, 2) *
         std::sqrt(step_s / (4.0 * std::sqrt(M_PI)) / std::pow(sd_s, 3));
}

void count_rows(std::span<const Run> runs, const std::array<double, kRowUses>& seconds, DriveData& data) {
  for (const Run& run : runs) data.rows.read += run.size();
  const double all = std::accumulate(seconds.begin(), seconds.end(), 0.0);
  double total_s = 0.0;
  for (const Run& run : runs) total_s += run.time_s.back() - run.time_s.front();
  if (!(all > 0.0) || !(total_s > 0.0)) return;
  const auto rows_in = [&](double time_s) {
    return static_cast<std::size_t>(
        std::llround(static_cast<double>(data.rows.read) * std::min(1.0, time_s / total_s)));
  };
  data.rows.used = rows_in(seconds[0] + (data.keeps_reversals ? seconds[4] : 0.0));
  const auto add = [&](const char* reason, std::size_t rows) {
    if (rows > 0) data.rows.left_out.push_back({reason, rows});
  };
  std::size_t left = data.rows.read - data.rows.used;
  constexpr std::array<const char*, 4> kReasons{"standstill: friction there is anything up to its limit",
                                                "a gap in the record", "the drive was off",
                                                "a reversal: for how long the drive sticks is not recorded"};
  for (std::size_t k = 0; k < kReasons.size(); ++k) {
    if (data.keeps_reversals && k == 3) continue;
    const std::size_t rows = std::min(left, rows_in(seconds[k + 1]));
    add(kReasons[k], rows);
    left -= rows;
  }
  add("ends of the runs, where the filter lacks a side", left);
}

/// Replaces the load's position.
void subtract_load(Run& run) {
  std::vector<double>& load = run.others.back().values;
  std::ranges::transform(run.position_rad, load, load.begin(), std::minus<>{});
}

/// At the cut-off given.
DriveData prepare_at(std::span<const Run> runs, std::size_t heldout_from, const DriveModel& model,
                     double cut_off_Hz, double delay_s, bool keeps_reversals = false) {
  DriveData data;
  data.delay_s = delay_s;
  data.keeps_reversals = keeps_reversals;
  data.cut_off_Hz = cut_off_Hz;
  data.position_absolute = !runs.front().position_rad.empty();
  std::array<double, kRowUses> seconds{};
  double torque_square = 0.0, acceleration_square = 0.0, count = 0.0;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const Run& run = runs[r];
    const double step_s = median_step(run.time_s);
    data.sample_s = r == 0 ? step_s : std::min(data.sample_s, step_s);
    const double here_Hz = std::min(cut_off_Hz, kHighestCutOff / step_s);
    const auto together =
        static_cast<std::size_t>(std::max(1.0, kRowsPerCutOff / here_Hz / step_s / kSamplesPerRow));
    Run average = averaged(run, together, model.torque_held);
    if (model.load_position) {
      subtract_load(average);
      for (const std::vector<double>* reading : {&run.position_rad, &run.others.back().values})
        data.position_step = std::max(data.position_step, data_check::step_of(*reading));
    }
    DriveRows rows = rows_of(average, here_Hz, data, seconds);
    rows.run = static_cast<int>(r);
    rows.heldout = r >= heldout_from;
    const auto size = static_cast<double>(rows.size());
    torque_square += size * std::pow(white_noise(run.time_s, run.torque_Nm, 2), 2) *
                     rows.sum_of_squared_weights / static_cast<double>(together);
    acceleration_square += size * std::pow(acceleration_noise(run, here_Hz), 2);
    count += size;
    data.runs.push_back(std::move(rows));
  }
  if (count > 0.0) data.noise = {std::sqrt(torque_square / count), std::sqrt(acceleration_square / count)};
  // A drive that swings to and fro all the time has hardly any other rows.
  if (!keeps_reversals && seconds[0] < seconds[static_cast<std::size_t>(RowUse::Reversal)])
    return prepare_at(runs, heldout_from, model, cut_off_Hz, delay_s, true);
  count_rows(runs, seconds, data);
  return data;
}

/// By a rough fit of inertia and friction.
struct RoughInertia {
  double inertia = kInfinity;
  double noise = kInfinity;  ///< of the acceleration, over the variation of the torque
  bool is_clear = false;     ///< the acceleration is hardly noise
  bool is_known = false;     ///< and the torque goes with it
};
RoughInertia rough_inertia(const DriveData& data) {
  constexpr double kHardly = 0.02, kGoesWith = 0.3;
  Eigen::Matrix4d gram = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  double square = 0.0, count = 0.0, sum = 0.0;
  for (const DriveRows& run : data.runs)
    for (Eigen::Index i = 0; i < run.torque.size(); ++i) {
      const Eigen::Vector4d columns(run.acceleration[i], run.velocity[i], run.direction[i], 1.0);
      gram += columns * columns.transpose();
      right += run.torque[i] * columns;
      square += run.torque[i] * run.torque[i];
      sum += run.torque[i];
      count += 1.0;
    }
  if (count < 20.0) return {};
  const double noise = std::pow(data.noise.acceleration, 2), measured = gram(0, 0) / count;
  const Eigen::Vector4d scale = gram.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::Matrix4d scaled =
      scale.asDiagonal() * gram * scale.asDiagonal() + 1e-9 * Eigen::Matrix4d::Identity();
  const Eigen::Matrix4d inverse = scale.asDiagonal() * scaled.inverse() * scale.asDiagonal();
  const Eigen::Vector4d fitted = inverse * right;
  const double taken = fitted[0] * fitted[0] / inverse(0, 0), left = square - right.dot(fitted);
  // Noise hides the inertia as it hides the acceleration.
  const double hidden = std::max(0.1, 1.0 - noise / std::max(measured, 1e-300));
  const double variation = std::sqrt(std::max(1e-300, square / count - std::pow(sum / count, 2)));
  const bool clear = noise < kHardly * measured;
  return {std::abs(fitted[0]) / hidden, data.noise.acceleration / variation, clear,
          clear && taken > kGoesWith * (taken + left)};
}

/// The highest cut-off with which the noise of the acceleration is of no account in the torque; where there
/// is none, the lowest with which something is gained. While the acceleration is mostly noise, no fit tells
/// how much torque it makes: the inertia is that of the first cut-off with which it is hardly any.
double cut_off_for_acceleration(std::span<const Run> runs, const DriveModel& model, double highest_Hz) {
  constexpr std::size_t kMostRounds = 12;
  constexpr double kStep = 1.3;
  double longest_s = 0.0;
  for (const Run& run : runs) longest_s = std::max(longest_s, run.time_s.back() - run.time_s.front());
  std::vector<RoughInertia> tried;
  for (double cut_off_Hz = highest_Hz; tried.size() < kMostRounds; cut_off_Hz /= kStep) {
    tried.push_back(rough_inertia(prepare_at(runs, runs.size(), model, cut_off_Hz, 0.0)));
    if (tried.back().is_clear || cut_off_Hz / kStep * longest_s < 40.0) break;
  }
  const bool known = tried.back().is_known;
  const auto noise_in_torque = [&](const RoughInertia& rough) {
    return (known ? tried.back().inertia : rough.inertia) * rough.noise;
  };
  for (std::size_t round = 0;; ++round) {
    const double noise = noise_in_torque(tried[round]);
    const double cut_off_Hz = highest_Hz / std::pow(kStep, static_cast<double>(round));
    const bool gained =
        round == 0 || !std::isfinite(noise) || noise < 0.95 * noise_in_torque(tried[round - 1]);
    if (noise <= kAccelerationNoise || !gained || cut_off_Hz / kStep * longest_s < 40.0 ||
        round + 1 == kMostRounds)
      return cut_off_Hz;
    if (round + 1 == tried.size())
      tried.push_back(rough_inertia(prepare_at(runs, runs.size(), model, cut_off_Hz / kStep, 0.0)));
  }
}

}  // namespace

DriveState DriveMotion::state(std::size_t i, int run, std::vector<double>& columns_here) const {
  columns_here.resize(columns.size());
  for (std::size_t c = 0; c < columns.size(); ++c) columns_here[c] = columns[c][i];
  return {time_s[i], run, position[i], velocity[i], acceleration[i], direction[i], travel[i], columns_here};
}

std::vector<double> DriveMotion::lacking_friction(double length) const {
  std::vector<double> result;
  double so_far = length * std::log(2.0), back = 0.0, sign = 0.0;
  for (std::size_t i = 0; i < position.size(); ++i) {
    const double step = i == 0 ? 0.0 : position[i] - position[i - 1];
    if (direction[i] != 0.0 && sign == 0.0) sign = direction[i];
    if (direction[i] == -sign && sign != 0.0) {
      sign = direction[i];
      so_far = travel_after_reversal(so_far, length) + back;
      back = 0.0;
    }
    // Until it is certain that the drive goes back, it may be noise: what it then has gone counts from the
    // turn.
    const double forward = step * sign;
    const double new_ground = std::max(0.0, forward - back);
    back = std::max(0.0, back - forward);
    so_far += new_ground;
    const double turned = back > 0.0 ? -1.0 : 1.0;
    const double since = back > 0.0 ? travel_after_reversal(so_far, length) + back : so_far;
    const double bent = turned * sign * (1.0 - 2.0 * std::exp(-since / length));
    result.push_back(0.5 * (bent - direction[i]));
  }
  return result;
}

double gaussian_sd_s(double cut_off_Hz) {
  return std::sqrt(std::log(2.0)) / (2.0 * M_PI * cut_off_Hz);
}

Eigen::VectorXd DriveRows::filtered(std::span<const double> samples) const {
  Eigen::VectorXd result(static_cast<Eigen::Index>(rows_.size()));
  for (std::size_t r = 0; r < rows_.size(); ++r) {
    double sum = 0.0;
    const Row& row = rows_[r];
    for (std::size_t k = 0; k < row.weights.size(); ++k) sum += row.weights[k] * samples[row.first + k];
    result[static_cast<Eigen::Index>(r)] = sum;
  }
  return result;
}

Eigen::VectorXd DriveRows::filtered(std::span<const double> samples, double lag_s) const {
  if (filter_sd_s_ == 0.0) return filtered(samples);
  Eigen::VectorXd result(static_cast<Eigen::Index>(rows_.size()));
  for (std::size_t r = 0; r < rows_.size(); ++r) {
    std::size_t first = 0;
    const double latest_s = motion.time_s.back();
    const std::vector<double> weights =
        kernel(motion.time_s, std::clamp(rows_[r].at_s - lag_s, 0.0, latest_s), filter_sd_s_, first);
    double sum = 0.0;
    for (std::size_t k = 0; k < weights.size(); ++k) sum += weights[k] * samples[first + k];
    result[static_cast<Eigen::Index>(r)] = sum;
  }
  return result;
}

Eigen::VectorXd DriveRows::torque_at(const Actuation& actuation) const {
  if (actuation == Actuation{}) return torque;
  std::vector<double> samples = settled(motion.time_s, motion.torque, actuation.settling_s);
  for (double& each : samples) each = actuation.saturation.torque(each);
  return filtered(samples, actuation.lag_s);
}

Result<DriveData> prepare(std::span<const Run> runs, std::size_t heldout_from, const DriveModel& model,
                          double delay_s) {
  if (runs.empty() || heldout_from == 0) return failure("no run to diagnose");
  for (const Run& run : runs)
    if (const Result<void> checked = check(run, model); !checked) return tl::unexpected(checked.error());
  DriveData data;
  if (model.steady) {
    data.position_absolute = false;
    data.cut_off_Hz = std::numeric_limits<double>::quiet_NaN();
    for (std::size_t r = 0; r < runs.size(); ++r) {
      data.runs.push_back(steady_row_of(runs[r]));
      data.runs.back().run = static_cast<int>(r);
      data.runs.back().heldout = r >= heldout_from;
      data.rows.read += runs[r].size();
      if (data.runs.back().size() > 0) data.rows.used += runs[r].size();
    }
    if (data.rows.used < data.rows.read)
      data.rows.left_out.push_back({"standstill", data.rows.read - data.rows.used});
  } else {
    const std::span<const Run> fitted = runs.first(heldout_from);
    double cut_off_Hz = model.cut_off_Hz;
    if (std::isnan(cut_off_Hz)) {
      cut_off_Hz = 0.0;
      double total_s = 0.0;
      for (const Run& run : fitted) cut_off_Hz = std::max(cut_off_Hz, torque_bandwidth_Hz(run));
      for (const Run& run : runs) total_s += run.time_s.back() - run.time_s.front();
      cut_off_Hz = std::min(cut_off_Hz, kMostRows * kRowsPerCutOff / total_s);
      cut_off_Hz = cut_off_for_acceleration(fitted, model, cut_off_Hz);
    }
    data = prepare_at(runs, heldout_from, model, cut_off_Hz, delay_s);
  }
  for (const DriveRows& run : data.runs)
    if (run.size() == 0) data.notices.push_back(fmt::format("{}: the drive does not move in it", run.name));
  std::erase_if(data.runs, [](const DriveRows& run) { return run.size() == 0; });
  if (std::ranges::none_of(data.runs, [](const DriveRows& run) { return !run.heldout; }))
    return failure("the drive stands still in every run; nothing can be told of it");
  return data;
}

}  // namespace clampd::drive
