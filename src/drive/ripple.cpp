#include <algorithm>
#include <cmath>
#include <complex>

#include <fmt/format.h>

#include "src/drive/selection.hpp"

namespace clampd::drive {
namespace {

constexpr double kMostPeriods = 400.0;  ///< over the travel
constexpr double kLeastPeriods = 2.0;   ///< fewer are a smooth function of the place, not a ripple
/// Of a rotary drive, orders nearer to 1 than the travel can tell are gravity's.
constexpr double kFromGravity = 1.5;
constexpr std::size_t kMostOrders = 6;
constexpr double kMostScanned = 5000.0;  ///< rows; the scan only proposes, all rows decide

std::vector<BasisFunction> functions_of(double factor, bool absolute, int runs) {
  std::vector<BasisFunction> functions;
  for (int owner = absolute ? -1 : 0; owner < (absolute ? 0 : runs); ++owner)
    for (const auto kind : {BasisFunction::Factor::Cosine, BasisFunction::Factor::Sine})
      functions.push_back({BasisFunction::Carrier::One, kind, factor, 1.0, owner});
  return functions;
}

/// Runs of rows that the scan looks at: whole runs, as many as its budget allows.
std::vector<std::size_t> scanned_runs(const DriveData& data) {
  std::vector<std::size_t> runs;
  double rows = 0.0;
  for (std::size_t r = 0; r < data.runs.size() && rows < kMostScanned; ++r) {
    if (data.runs[r].heldout) continue;
    runs.push_back(r);
    rows += static_cast<double>(data.runs[r].size());
  }
  return runs;
}

struct Scan {
  double first = 0.0, step = 0.0;
  std::vector<double> gain;  ///< share of the whitened residual's square
};

/// Of the rows' residuals (each run's mean removed), the share that each order takes, run by run where the
/// phase is not absolute.
/// The torque's carrier is 1, or one value a row.
Scan scanned(const Design& design, const Eigen::VectorXd& residuals, double lowest, double highest,
             double step, const Eigen::VectorXd* carrier = nullptr) {
  const DriveData& data = design.data();
  Scan scan{lowest, step, std::vector<double>(static_cast<std::size_t>((highest - lowest) / step) + 1, 0.0)};
  const auto orders = scan.gain.size();
  double total = 0.0, most = 0.0;
  std::vector<std::complex<double>> sums(orders, 0.0);
  std::vector<double> weights(orders, 0.0);
  std::vector<Eigen::Index> firsts;
  Eigen::Index first = 0;
  for (const DriveRows& run : data.runs) {
    firsts.push_back(first);
    first += static_cast<Eigen::Index>(run.size());
  }
  const std::vector<std::size_t> used = scanned_runs(data);
  const double filter_s = gaussian_sd_s(data.cut_off_Hz);
  for (const std::size_t r : used) {
    const DriveRows& run = data.runs[r];
    std::vector<std::complex<double>> mine(orders, 0.0);
    std::vector<double> power(orders, 0.0);
    for (Eigen::Index i = 0; i < run.position.size(); ++i) {
      const double carried = carrier == nullptr ? 1.0 : (*carrier)[firsts[r] + i];
      total += std::pow(residuals[firsts[r] + i], 2);
      most += carried * carried;
      const double value = residuals[firsts[r] + i] * carried;
      const double speed = std::abs(run.velocity[i]);
      std::complex<double> turn = std::polar(1.0, lowest * run.position[i]);
      const std::complex<double> increment = std::polar(1.0, step * run.position[i]);
      for (std::size_t k = 0; k < orders; ++k, turn *= increment) {
        const double factor = lowest + step * static_cast<double>(k);
        const double pace = factor * speed;
        if (pace * data.sample_s > 0.8 * M_PI) break;  // an alias from here on
        const double u = pace * filter_s;
        if (u > 3.0) break;  // the rows' filter leaves nothing of it
        const double passed = std::exp(-0.5 * u * u);
        mine[k] += passed * value * turn;
        power[k] += passed * passed * carried * carried;
      }
    }
    for (std::size_t k = 0; k < orders; ++k) {
      if (data.position_absolute) {
        sums[k] += mine[k];
        weights[k] += power[k];
      } else if (power[k] > 0.0) {
        scan.gain[k] += 2.0 * std::norm(mine[k]) / power[k];
        weights[k] += power[k];
      }
    }
  }
  for (std::size_t k = 0; k < orders; ++k) {
    if (data.position_absolute && weights[k] > 0.0) scan.gain[k] = 2.0 * std::norm(sums[k]) / weights[k];
    // An order that only few rows resolve is one of them, not the drive's.
    scan.gain[k] = weights[k] < 0.15 * most || !(total > 0.0) ? 0.0 : scan.gain[k] / total;
  }
  return scan;
}

double longest_travel(const DriveData& data) {
  double longest = 0.0;
  for (const DriveRows& run : data.runs)
    if (!run.heldout) longest = std::max(longest, run.position.maxCoeff() - run.position.minCoeff());
  return longest;
}

/// Where the scan's parabola through a value and its neighbours has its peak.
double peak_of(const Scan& scan, std::size_t k) {
  double factor = scan.first + scan.step * static_cast<double>(k);
  if (k > 0 && k + 1 < scan.gain.size()) {
    const double a = scan.gain[k - 1], b = scan.gain[k], c = scan.gain[k + 1];
    if (b >= a && b >= c && a - 2.0 * b + c < 0.0) factor += 0.5 * scan.step * (a - c) / (a - 2.0 * b + c);
  }
  return factor;
}

std::vector<std::size_t> strongest_first(const Scan& scan) {
  std::vector<std::size_t> order(scan.gain.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  std::ranges::sort(order, [&](std::size_t a, std::size_t b) { return scan.gain[a] > scan.gain[b]; });
  return order;
}

}  // namespace

std::vector<Variant> waves_in(const Design& design, const Eigen::VectorXd& residuals, const DriveRange& range,
                              const DriveModel& model, DriveTerm term) {
  // Fewer periods are as well a slope and a curvature; more than these are no property of the way.
  constexpr double kFewest = 0.6, kMost = 30.0;
  constexpr double kLeastOfATurn = 0.2;
  constexpr std::size_t kProposed = 3;
  const DriveData& data = design.data();
  const double longest = longest_travel(data);
  if (!(longest > 0.0) || !(data.cut_off_Hz > 0.0) || (!data.position_absolute && range.runs > 1)) return {};
  const double period = 2.0 * M_PI / longest;
  const double highest =
      std::min(2.0 * M_PI * data.cut_off_Hz / std::max(range.slow, 0.1 * range.fast), kMost * period);
  const double lowest = kFewest * period;
  const bool inertia = term == DriveTerm::InertiaPosition;
  // In one direction friction that goes up and down is a load that does.
  constexpr double kLeastOfADirection = 0.15;
  if (!inertia && std::abs(range.forward - 0.5) > 0.5 - kLeastOfADirection) return {};
  Eigen::VectorXd carrier(design.rows());
  Eigen::Index first = 0;
  for (const DriveRows& run : data.runs) {
    const auto size = static_cast<Eigen::Index>(run.size());
    carrier.segment(first, size) = inertia ? run.acceleration : run.direction;
    first += size;
  }
  Scan scan;
  if (highest > lowest) scan = scanned(design, residuals, lowest, highest, 0.25 * period, &carrier);
  std::vector<Variant> variants;
  std::vector<double> tried;
  const auto propose = [&](double factor) {
    if (std::ranges::any_of(tried, [&](double other) { return std::abs(factor - other) < 0.4 * period; }))
      return;
    tried.push_back(factor);
    Variant variant{term, std::string(name_of(term)), {}};
    for (const auto kind : {BasisFunction::Factor::Sine, BasisFunction::Factor::Cosine})
      variant.functions.push_back(
          {inertia ? BasisFunction::Carrier::Acceleration : BasisFunction::Carrier::Direction, kind, factor});
    variant.alternatives = std::max(2.0, static_cast<double>(scan.gain.size()));
    variants.push_back(std::move(variant));
  };
  // Once a turn is what one expects of a rotary drive, of which a part of a turn is enough.
  if (!model.linear && 1.0 > kLeastOfATurn * period && 1.0 < highest) propose(1.0);
  for (const std::size_t k : strongest_first(scan)) {
    if (variants.size() >= kProposed || !(scan.gain[k] > 0.0)) break;
    double factor = peak_of(scan, k);
    if (!model.linear && std::abs(factor - std::round(factor)) < 0.1 * period && factor > 0.5)
      factor = std::round(factor);
    propose(factor);
  }
  return variants;
}

std::vector<Variant> ripples_in(const Design& design, const Eigen::VectorXd& residuals,
                                const DriveRange& range, const DriveModel& model, const Variant* already,
                                std::string* why_not) {
  const DriveData& data = design.data();
  const auto refuse = [&](std::string reason) {
    if (why_not != nullptr) *why_not = std::move(reason);
    return std::vector<Variant>{};
  };
  const double longest = longest_travel(data);
  if (!(longest > 0.0) || !(data.cut_off_Hz > 0.0))
    return refuse("a run at steady speed counts as one point without a place");
  const double middle_speed = std::max(range.slow, 0.1 * range.fast);
  const double highest =
      std::min({2.0 * M_PI * data.cut_off_Hz / middle_speed, 2.0 * M_PI * kMostPeriods / longest});
  const double lowest = std::max(kLeastPeriods * 2.0 * M_PI / longest,
                                 model.linear ? 0.0 : 1.0 + kFromGravity * 2.0 * M_PI / longest);
  if (!(highest > lowest))
    return refuse(
        "the runs are too short, or the motion too fast for the sampling, for two periods of a ripple");
  const double step = std::min(0.35 * 2.0 * M_PI / longest, 0.5 * (highest - lowest));
  const Scan scan = scanned(design, residuals, lowest, highest, step);
  std::vector<Variant> variants;
  std::vector<double> tried;
  for (const std::size_t k : strongest_first(scan)) {
    if (variants.size() >= 4 || !(scan.gain[k] > 0.0)) break;
    double factor = peak_of(scan, k);
    // Poles and gear teeth are whole numbers: where one is as near as the travel can tell, it is that.
    if (!model.linear && std::abs(factor - std::round(factor)) < 0.3 * 2.0 * M_PI / longest)
      factor = std::round(factor);
    const auto near = [&](double other) { return std::abs(factor - other) < 2.0 * scan.step; };
    bool known = std::ranges::any_of(tried, near);
    if (already != nullptr)
      for (const BasisFunction& function : already->functions) known = known || near(function.first);
    if (known || (already != nullptr &&
                  already->functions.size() >=
                      kMostOrders * functions_of(1.0, data.position_absolute, range.runs).size()))
      continue;
    tried.push_back(factor);
    Variant variant{DriveTerm::Cogging, std::string(name_of(DriveTerm::Cogging)), {}};
    if (already != nullptr) variant.functions = already->functions;
    for (const BasisFunction& function : functions_of(factor, data.position_absolute, range.runs))
      variant.functions.push_back(function);
    variant.alternatives =
        (already != nullptr ? already->alternatives : 1.0) * static_cast<double>(scan.gain.size());
    variants.push_back(std::move(variant));
  }
  return variants;
}

}  // namespace clampd::drive
