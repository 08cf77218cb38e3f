#include "src/diagnose/drive_residuals.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <string_view>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"
#include "clampd/statistics/distributions.hpp"

namespace clampd::drive {

namespace {

/// Of the chance of a false alarm, what a misfit without a name may take.
constexpr double kUnnamedShare = 0.1;

/// A value of each row, for the tests on what the rest depends on.
Eigen::VectorXd variable_of(const DriveFit& fit, std::string_view name) {
  std::vector<double> values;
  double run_number = 0.0;
  for (const DriveRows& run : fit.data().runs) {
    for (Eigen::Index i = 0; i < run.velocity.size(); ++i)
      values.push_back(name == "position"    ? run.position[i]
                       : name == "velocity"  ? run.velocity[i]
                       : name == "direction" ? (run.velocity[i] > 0.0 ? 1.0 : -1.0)
                       : name == "time"      ? run.time_s[i]
                                             : run_number);
    run_number += 1.0;
  }
  return Eigen::Map<Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

/// A step function of eight levels beside the model.
std::optional<DependenceTest> dependence_on(std::string_view name, const Fitted& model, const DriveFit& fit,
                                            double tests) {
  const Eigen::VectorXd values = variable_of(fit, name);
  std::vector<double> sorted(values.data(), values.data() + values.size());
  std::sort(sorted.begin(), sorted.end());
  constexpr std::size_t kLevels = 8;
  std::vector<double> edges;
  for (std::size_t k = 1; k < kLevels; ++k) edges.push_back(sorted[sorted.size() * k / kLevels]);
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  Eigen::MatrixXd columns = model.columns;
  int added = 0;
  for (std::size_t k = 0; k <= edges.size(); ++k) {
    const double from = k == 0 ? -std::numeric_limits<double>::infinity() : edges[k - 1];
    const double to = k == edges.size() ? std::numeric_limits<double>::infinity() : edges[k];
    const Eigen::VectorXd level =
        values.unaryExpr([&](double value) { return value >= from && value < to ? 1.0 : 0.0; });
    if (share_of_its_own(columns, level) < 0.02) continue;
    columns.conservativeResize(Eigen::NoChange, columns.cols() + 1);
    columns.rightCols(1) = level;
    ++added;
  }
  if (added == 0) return std::nullopt;
  const Regression with = regress(columns, fit.target(), fit.blocks());
  const double significance_nats = with.significance_of_last(added);
  DependenceTest test;
  test.share = 1.0 - with.residual_square / model.regression.residual_square;
  test.dependence = {std::string(name), Location::TorqueBalance,
                     0.5 * effective_size(with.residuals) *
                         std::log(model.regression.residual_square / with.residual_square),
                     std::min(1.0, tests * std::exp(-significance_nats))};
  const double before =
      std::accumulate(model.regression.heldout_square.begin(), model.regression.heldout_square.end(), 0.0);
  const double after = std::accumulate(with.heldout_square.begin(), with.heldout_square.end(), 0.0);
  test.holds = after < (1.0 - 0.5 * kMaterialShare) * before;
  return test;
}

}  // namespace

MisfitTest whiteness(const Eigen::VectorXd& residuals) {
  const Eigen::Index n = residuals.size();
  MisfitTest test{"whiteness of the torque", 0.0, 1.0, "what is left of the torque looks like noise"};
  constexpr Eigen::Index kLags = 10;
  const double square = residuals.squaredNorm();
  if (n < 3 * kLags || !(square > 0.0)) return test;
  const double size = static_cast<double>(n);
  for (Eigen::Index lag = 1; lag <= kLags; ++lag) {
    const double correlation = residuals.head(n - lag).dot(residuals.tail(n - lag)) / square;
    test.statistic += size * (size + 2.0) * correlation * correlation / (size - static_cast<double>(lag));
  }
  test.p_value = statistics::chi_squared_p_value(test.statistic, static_cast<double>(kLags));
  if (test.p_value < 0.01)
    test.words = "what is left of the torque has a memory; uncertainties count it in blocks of time";
  return test;
}

std::vector<MisfitTest> tests_of(const Fitted& model, const DriveFit& fit) {
  const double relative = relative_error(model, fit);
  return {{"relative torque error", relative, kNaN,
           fmt::format("{:.2f} % of the torque is not explained, over all rows", 100.0 * relative)},
          whiteness(model.regression.residuals)};
}

std::vector<DependenceTest> dependences(const Fitted& model, const DriveFit& fit, double false_alarm) {
  std::vector<std::string_view> names{"velocity"};
  if (fit.data().position_absolute) names.push_back("position");
  if (fit.both_directions()) names.push_back("direction");
  if (fit.blocks().size() > fit.data().runs.size()) names.push_back("time");
  if (fit.data().runs.size() > 1 && fit.blocks().size() > fit.data().runs.size()) names.push_back("run");
  std::vector<DependenceTest> found;
  for (const std::string_view name : names) {
    const auto test = dependence_on(name, model, fit, static_cast<double>(names.size()));
    if (test && test->holds && test->dependence.p_value < kUnnamedShare * false_alarm &&
        test->share > kMaterialShare)
      found.push_back(*test);
  }
  std::sort(found.begin(), found.end(), [](const DependenceTest& a, const DependenceTest& b) {
    return a.dependence.gain > b.dependence.gain;
  });
  return found;
}

}  // namespace clampd::drive
