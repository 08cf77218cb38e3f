#include "src/drive/steady_ripple.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "clampd/statistics/distributions.hpp"
#include "src/drive/regression.hpp"

namespace clampd::drive {
namespace {

constexpr int kHighestOrder = 32;
constexpr std::size_t kMaxRippleOrders = 6;
constexpr int kBlocks = 12;
constexpr double kLeastOrderShare = 0.02;

struct SteadyRun {
  Eigen::VectorXd angle, torque;
  Eigen::MatrixXd columns;  ///< constant, trend and the orders found so far
  std::vector<int> block;
  double highest = 0.0, lowest = 0.0;  ///< orders that it resolves
  bool forward = false;
};

std::optional<SteadyRun> steady_run(const Run& run) {
  const std::size_t n = run.size();
  if (n < 10 * kBlocks) return std::nullopt;
  const auto size = static_cast<Eigen::Index>(n);
  SteadyRun result;
  result.torque = Eigen::Map<const Eigen::VectorXd>(run.torque_Nm.data(), size);
  result.angle = Eigen::VectorXd::Zero(size);
  for (std::size_t i = 1; i < n; ++i)
    result.angle[static_cast<Eigen::Index>(i)] =
        run.velocity_rad_s.empty() ? run.position_rad[i] - run.position_rad[0]
                                   : result.angle[static_cast<Eigen::Index>(i) - 1] +
                                         0.5 * (run.velocity_rad_s[i] + run.velocity_rad_s[i - 1]) *
                                             (run.time_s[i] - run.time_s[i - 1]);
  const double travel = std::abs(result.angle[size - 1]);
  const double step = travel / static_cast<double>(n - 1);
  if (!(travel > 0.0)) return std::nullopt;
  result.forward = result.angle[size - 1] > 0.0;
  // At least three periods, and at least three samples in each.
  result.lowest = 3.0 * 2.0 * M_PI / travel;
  result.highest = 2.0 * M_PI / (3.0 * step);
  result.columns.resize(size, 2);
  for (Eigen::Index i = 0; i < size; ++i) {
    const double place = static_cast<double>(i) / static_cast<double>(n);
    result.columns.row(i) << 1.0, place - 0.5;
    result.block.push_back(std::min(kBlocks - 1, static_cast<int>(place * kBlocks)));
  }
  return result;
}

Eigen::MatrixXd with_order(const SteadyRun& run, double order) {
  Eigen::MatrixXd columns(run.columns.rows(), run.columns.cols() + 2);
  columns << run.columns, (order * run.angle.array()).cos(), (order * run.angle.array()).sin();
  return columns;
}

struct OrderTrial {
  double significance_nats = 0.0;
  double gain = 0.0;
  double share = 0.0;
  bool holds = false;
};

std::optional<OrderTrial> trial_of(const std::vector<SteadyRun>& runs, double order) {
  double log_p = 0.0, gain = 0.0, variance = 0.0, taken = 0.0, heldout_before = 0.0, heldout_after = 0.0;
  int resolved = 0;
  for (const SteadyRun& run : runs) {
    if (order < run.lowest || order > run.highest) continue;
    const Regression without = regress(run.columns, run.torque, run.block);
    const Regression with = regress(with_order(run, order), run.torque, run.block);
    log_p += with.significance_of_last(2);
    gain += 0.5 * effective_size(with.residuals) * std::log(without.residual_square / with.residual_square);
    const double total = (run.torque.array() - run.torque.mean()).square().sum();
    taken += (without.residual_square - with.residual_square) / total;
    variance += 1.0;
    for (std::size_t b = 0; b < with.judged.size(); ++b) {
      if (!with.judged[b] || !without.judged[b]) continue;
      heldout_before += without.heldout_square[b] / total;
      heldout_after += with.heldout_square[b] / total;
    }
    ++resolved;
  }
  if (resolved < 3 || 2 * static_cast<std::size_t>(resolved) < runs.size()) return std::nullopt;
  // Fisher: of independent runs without this order, twice the sum is a chi-square of two each.
  const double p = statistics::chi_squared_p_value(2.0 * log_p, 2.0 * resolved);
  return OrderTrial{-std::log(std::max(1e-300, p)), gain, taken / variance,
                    heldout_after < (1.0 - 0.01) * heldout_before};
}

SteadyRipple::Order amplitudes(const std::vector<SteadyRun>& runs, double order, double share) {
  SteadyRipple::Order result;
  result.order = order;
  result.share = share;
  for (const bool forward : {true, false}) {
    double sum = 0.0, square = 0.0, count = 0.0;
    for (const SteadyRun& run : runs) {
      if (run.forward != forward || order < run.lowest || order > run.highest) continue;
      const Regression fit = regress(with_order(run, order), run.torque, run.block);
      const double amplitude = fit.coefficients.tail(2).norm();
      sum += amplitude;
      square += amplitude * amplitude;
      count += 1.0;
    }
    const double mean = count > 0.0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
    const double sd = count > 1.0
                          ? std::sqrt(std::max(0.0, square - count * mean * mean) / (count - 1.0) / count)
                          : std::numeric_limits<double>::quiet_NaN();
    (forward ? result.forward : result.backward) = mean;
    (forward ? result.forward_sd : result.backward_sd) = sd;
  }
  return result;
}

}  // namespace

SteadyRipple steady_ripple(std::span<const Run> runs, const DriveModel& model, double alarm) {
  SteadyRipple result;
  if (model.linear) {
    result.reason = "where a position is a length, the period is not known beforehand";
    return result;
  }
  std::vector<SteadyRun> steady;
  for (const Run& run : runs)
    if (std::optional<SteadyRun> each = steady_run(run)) steady.push_back(std::move(*each));
  int tried = 0;
  for (int order = 1; order <= kHighestOrder; ++order)
    if (trial_of(steady, order)) ++tried;
  if (tried == 0) {
    result.reason = "the runs are too short, or the motion too fast for the sampling, for whole turns";
    return result;
  }
  result.tested = true;
  std::vector<int> used;
  while (used.size() < kMaxRippleOrders) {
    OrderTrial best;
    int at = 0;
    for (int order = 1; order <= kHighestOrder; ++order) {
      if (std::find(used.begin(), used.end(), order) != used.end()) continue;
      const std::optional<OrderTrial> trial = trial_of(steady, order);
      if (trial && trial->gain > best.gain) {
        best = *trial;
        at = order;
      }
    }
    const double significance_nats = best.significance_nats - std::log(tried);
    if (used.empty()) result.significance_nats = significance_nats;
    if (at == 0 || significance_nats < alarm || !best.holds || best.share < kLeastOrderShare) break;
    used.push_back(at);
    result.gain += best.gain;
    result.orders.push_back(amplitudes(steady, at, best.share));
    for (SteadyRun& run : steady)
      if (at >= run.lowest && at <= run.highest) run.columns = with_order(run, at);
  }
  return result;
}

}  // namespace clampd::drive
