#include "src/drive/remainder.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::drive {
namespace {

constexpr int kLevels = 12;           ///< of a free function of one variable
constexpr int kPairLevels = 6;        ///< of each of two
constexpr double kNoiseFactor = 1.5;  ///< of the variance: the readings' noise is known no better
constexpr double kWhite = 0.35;       ///< correlation of neighbouring rows; the rows' filter alone makes 0.1
constexpr double kLeastDependence = 0.02;

/// Number of the level that each value lies in, by quantiles of the fitted rows. Equal values share a level.
std::vector<int> levels_of(const Design& design, const Eigen::VectorXd& values, int count, int& levels) {
  std::vector<double> sorted;
  for (int b = 0; b < design.fitted_blocks(); ++b)
    for (Eigen::Index i = 0; i < design.block(b).second; ++i)
      sorted.push_back(values[design.block(b).first + i]);
  std::ranges::sort(sorted);
  std::vector<double> edges;
  for (int k = 1; k < count; ++k) {
    const double edge = sorted[sorted.size() * static_cast<std::size_t>(k) / static_cast<std::size_t>(count)];
    if (edge > sorted.front() && (edges.empty() || edge > edges.back())) edges.push_back(edge);
  }
  levels = static_cast<int>(edges.size()) + 1;
  std::vector<int> result;
  for (const double value : values)
    result.push_back(static_cast<int>(std::ranges::upper_bound(edges, value) - edges.begin()));
  return result;
}

/// Indicator columns of several groupings of rows; fitted with a ridge and judged fold by fold.
class Cells {
 public:
  explicit Cells(const Design& design) : design_(design) {}

  void add(const std::vector<int>& level, int levels) {
    if (levels < 2) return;
    groups_.push_back(level);
    firsts_.push_back(count_);
    count_ += levels;
  }

  /// Share of the residuals' square that the fit to the other folds takes; may be negative.
  double share(const Eigen::VectorXd& residuals) const {
    if (count_ == 0) return 0.0;
    std::vector<Eigen::MatrixXd> grams(Design::kFolds, Eigen::MatrixXd::Zero(count_, count_));
    std::vector<Eigen::VectorXd> rights(Design::kFolds, Eigen::VectorXd::Zero(count_));
    each_row([&](int fold, Eigen::Index row) {
      const auto f = static_cast<std::size_t>(fold);
      for (std::size_t g = 0; g < groups_.size(); ++g) {
        const int a = at(g, row);
        rights[f][a] += residuals[row];
        for (std::size_t h = 0; h <= g; ++h) grams[f](a, at(h, row)) += 1.0;
      }
    });
    Eigen::MatrixXd all = Eigen::MatrixXd::Zero(count_, count_);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(count_);
    for (std::size_t f = 0; f < grams.size(); ++f) {
      grams[f].triangularView<Eigen::StrictlyUpper>() = grams[f].transpose();
      all += grams[f];
      right += rights[f];
    }
    double best = 0.0;
    for (const double ridge : {3.0, 30.0, 300.0}) {
      std::vector<Eigen::VectorXd> effects;
      for (std::size_t f = 0; f < grams.size(); ++f) {
        Eigen::MatrixXd matrix = all - grams[f];
        matrix.diagonal().array() += ridge;
        effects.push_back(statistics::SymmetricFactor(matrix).solve(right - rights[f]));
      }
      double before = 0.0, after = 0.0;
      each_row([&](int fold, Eigen::Index row) {
        double value = residuals[row];
        before += value * value;
        for (std::size_t g = 0; g < groups_.size(); ++g)
          value -= effects[static_cast<std::size_t>(fold)][at(g, row)];
        after += value * value;
      });
      if (before > 0.0) best = std::max(best, 1.0 - after / before);
    }
    return best;
  }

 private:
  int at(std::size_t group, Eigen::Index row) const {
    return firsts_[group] + groups_[group][static_cast<std::size_t>(row)];
  }

  template <class Visit>
  void each_row(const Visit& visit) const {
    for (int b = 0; b < design_.fitted_blocks(); ++b)
      for (Eigen::Index i = 0; i < design_.block(b).second; ++i)
        visit(design_.fold_of(b), design_.block(b).first + i);
  }

  const Design& design_;
  std::vector<std::vector<int>> groups_;
  std::vector<int> firsts_;
  int count_ = 0;
};

std::vector<int> crossed(const std::vector<int>& a, const std::vector<int>& b, int levels_b) {
  std::vector<int> result(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) result[i] = a[i] * levels_b + b[i];
  return result;
}

/// One value a row, of everything recorded that a torque may be a function of.
std::vector<std::string> recorded(const Design& design, const DriveModel& drive) {
  std::vector<std::string> names{"velocity"};
  if (!drive.steady) names.emplace_back("acceleration");
  if (design.data().position_absolute || design.data().runs.size() == 1) names.emplace_back("position");
  for (const DriveRegressor& regressor : drive.regressors) names.push_back(regressor.name);
  return names;
}

double explainable(const Design& design, const Eigen::VectorXd& residuals, const DriveModel& drive) {
  if (design.fitted_rows() < 200.0) return std::numeric_limits<double>::quiet_NaN();
  const std::vector<std::string> names = recorded(design, drive);
  int directions = 0;
  const std::vector<int> direction =
      levels_of(design, variable_of(design, "direction", drive), 2, directions);
  Cells cells(design);
  std::vector<std::vector<int>> coarse;
  std::vector<int> counts;
  for (const std::string& name : names) {
    int levels = 0, few = 0;
    const Eigen::VectorXd values = variable_of(design, name, drive);
    const std::vector<int> fine = levels_of(design, values, kLevels, levels);
    cells.add(crossed(fine, direction, directions), levels * directions);
    coarse.push_back(levels_of(design, values, kPairLevels, few));
    counts.push_back(few);
  }
  for (std::size_t a = 0; a < std::min<std::size_t>(names.size(), 5); ++a)
    for (std::size_t b = 0; b < a; ++b)
      cells.add(crossed(coarse[a], coarse[b], counts[b]), counts[a] * counts[b]);
  return cells.share(residuals);
}

double mean_square(const Design& design, const Eigen::VectorXd& values, bool about_mean) {
  double sum = 0.0, square = 0.0;
  for (int b = 0; b < design.fitted_blocks(); ++b) {
    sum += values.segment(design.block(b).first, design.block(b).second).sum();
    square += values.segment(design.block(b).first, design.block(b).second).squaredNorm();
  }
  const double mean = about_mean ? sum / design.fitted_rows() : 0.0;
  return std::max(0.0, square / design.fitted_rows() - mean * mean);
}

/// Mean square, unwhitened, on rows of each fold by fits to the others (or on the held-out runs).
double left_square(const Design& design, const TorqueModel& model) {
  const Eigen::VectorXd residuals = design.residuals(model.fit);
  double heldout = 0.0, rows = 0.0;
  for (int b = design.fitted_blocks(); b < design.blocks(); ++b) {
    heldout += residuals.segment(design.block(b).first, design.block(b).second).squaredNorm();
    rows += static_cast<double>(design.block(b).second);
  }
  if (rows > 0.0) return heldout / rows;
  // The whitened squares say by how much a fit to the others does worse; the same factor holds for the rows
  // themselves.
  const std::vector<double> left = design.left_out(model.fit);
  const std::vector<double> fitted = design.fitted_squares(model.fit);
  double sum = 0.0, same = 0.0;
  for (std::size_t b = 0; b < left.size(); ++b) {
    if (std::isnan(left[b])) continue;
    sum += left[b];
    same += fitted[b];
  }
  const double factor = same > 0.0 ? std::max(1.0, sum / same) : 1.0;
  return mean_square(design, residuals, false) * factor;
}

double neighbour_correlation(const Design& design, const Eigen::VectorXd& residuals) {
  double product = 0.0, square = 0.0;
  for (int b = 0; b < design.fitted_blocks(); ++b) {
    const auto [from, length] = design.block(b);
    for (Eigen::Index i = 1; i < length; ++i) product += residuals[from + i] * residuals[from + i - 1];
    square += residuals.segment(from, length).squaredNorm() *
              static_cast<double>(std::max<Eigen::Index>(length - 1, 0)) / static_cast<double>(length);
  }
  return square > 0.0 ? product / square : 0.0;
}

/// Runs that repeat the same motion tell the noise, whatever the model: half of the mean square of their
/// difference.
double repeats_noise(const Design& design, const Eigen::VectorXd& residuals) {
  double least = 0.0, rows = 0.0;
  Eigen::Index first = 0;
  const auto& runs = design.data().runs;
  for (std::size_t r = 0; r + 1 < runs.size(); ++r) {
    const auto size = static_cast<Eigen::Index>(runs[r].size());
    const DriveRows &a = runs[r], &b = runs[r + 1];
    if (!b.heldout && a.size() == b.size() && a.size() > 20) {
      const double apart = (a.velocity - b.velocity).squaredNorm(), motion = a.velocity.squaredNorm();
      if (apart < 1e-4 * motion && (a.time_s - b.time_s).cwiseAbs().maxCoeff() < 1e-3 * a.time_s[size - 1]) {
        least += 0.5 * (residuals.segment(first, size) - residuals.segment(first + size, size)).squaredNorm();
        rows += static_cast<double>(size);
      }
    }
    first += size;
  }
  return rows > 0.0 ? least / rows : 0.0;
}

/// +1 in rows that go forward, -1 in all others.
Eigen::VectorXd side_of(const DriveRows& run) {
  return run.direction.unaryExpr([](double d) { return d > 0.0 ? 1.0 : -1.0; });
}

}  // namespace

bool Remainder::is_noise() const {
  return left * left <= kNoiseFactor * noise * noise && correlation < kWhite;
}

Eigen::VectorXd variable_of(const Design& design, std::string_view name, const DriveModel& drive) {
  Eigen::VectorXd result(design.rows());
  Eigen::Index first = 0;
  for (const DriveRows& run : design.data().runs) {
    const auto size = static_cast<Eigen::Index>(run.size());
    auto part = result.segment(first, size);
    first += size;
    if (name == "velocity")
      part = run.velocity;
    else if (name == "acceleration")
      part = run.acceleration;
    else if (name == "position")
      part = run.position;
    else if (name == "direction")
      part = side_of(run);
    else if (name == "time")
      part = run.time_s;
    else if (name == "run")
      part.setConstant(run.run);
    else if (name == "travel")
      part = run.travel;
    else
      for (std::size_t c = 0; c < drive.regressors.size(); ++c)
        if (drive.regressors[c].name == name) part = run.filtered(run.motion.columns[c]);
  }
  return result;
}

double free_function_share(const Design& design, const Eigen::VectorXd& residuals,
                           const Eigen::VectorXd& variable) {
  int levels = 0, directions = 0;
  Eigen::VectorXd direction(design.rows());
  Eigen::Index first = 0;
  for (const DriveRows& run : design.data().runs) {
    direction.segment(first, static_cast<Eigen::Index>(run.size())) = side_of(run);
    first += static_cast<Eigen::Index>(run.size());
  }
  const std::vector<int> level = levels_of(design, variable, kLevels, levels);
  const std::vector<int> side = levels_of(design, direction, 2, directions);
  Cells cells(design);
  cells.add(crossed(level, side, directions), levels * directions);
  return cells.share(residuals);
}

Remainder remainder_of(const Design& design, const TorqueModel& model, double inertia) {
  Remainder result;
  const Eigen::VectorXd residuals = design.residuals(model.fit);
  result.variation =
      design.scale_of(model.fit) * std::sqrt(mean_square(design, design.raw(model.fit.target), true));
  result.left = std::sqrt(left_square(design, model));
  result.share =
      result.variation > 0.0 ? result.left / result.variation : std::numeric_limits<double>::quiet_NaN();
  const ReadingNoise& noise = design.data().noise;
  const double by_readings = noise.torque * noise.torque + std::pow(inertia * noise.acceleration, 2);
  result.noise = std::sqrt(std::max(by_readings, repeats_noise(design, residuals)));
  result.correlation = neighbour_correlation(design, residuals);
  return result;
}

std::vector<DependenceTest> dependences(const Design& design, const TorqueModel& model,
                                        const DriveModel& drive) {
  std::vector<DependenceTest> tests;
  const Eigen::VectorXd residuals = design.residuals(model.fit);
  std::vector<std::string> names = recorded(design, drive);
  names.emplace_back("direction");
  names.emplace_back("time");
  if (design.data().runs.size() > 1) names.emplace_back("run");
  // By the rows' own memory there are fewer independent ones.
  const double rho = std::clamp(neighbour_correlation(design, residuals), 0.0, 0.99);
  const double independent = (1.0 - rho) / (1.0 + rho);
  const double rows = design.fitted_rows();
  for (const std::string& name : names) {
    DependenceTest test;
    test.dependence.variable = name;
    test.share = free_function_share(design, residuals, variable_of(design, name, drive));
    if (test.share < kLeastDependence) continue;
    test.dependence.gain = -0.5 * rows * std::log(std::max(1e-12, 1.0 - test.share));
    test.dependence.gain *= independent;
    test.dependence.p_value =
        std::min(1.0, std::exp(-test.dependence.gain));  // held out, so that no level is counted against it
    tests.push_back(std::move(test));
  }
  std::ranges::sort(tests,
                    [](const DependenceTest& a, const DependenceTest& b) { return a.share > b.share; });
  return tests;
}

double explainable_share(const Design& design, const TorqueModel& model, const DriveModel& drive) {
  return explainable(design, design.residuals(model.fit), drive);
}

double independent_rows(const Design& design, const TorqueModel& model) {
  const Eigen::VectorXd residuals = design.residuals(model.fit);
  const auto product = [&](Eigen::Index lag) {
    double sum = 0.0;
    Eigen::Index first = 0;
    for (const DriveRows& run : design.data().runs) {
      const auto size = static_cast<Eigen::Index>(run.size());
      if (!run.heldout && size > lag)
        sum += residuals.segment(first, size - lag).dot(residuals.segment(first + lag, size - lag));
      first += size;
    }
    return sum;
  };
  const double square = product(0);
  // Lags that grow by an eighth: the autocorrelation of what is smooth in time is smooth, too.
  double sum = 1.0, last = 1.0;
  for (Eigen::Index lag = 1, previous = 0; lag < residuals.size();) {
    const double now = product(lag) / square;
    if (!(now > 0.0)) break;
    sum += static_cast<double>(lag - previous) * (previous == 0 ? 2.0 * now : last + now);
    last = now;
    previous = lag;
    lag += std::max<Eigen::Index>(1, lag / 8);
  }
  return design.fitted_rows() / sum;
}

std::vector<MisfitTest> tests_of(const Design& design, const TorqueModel& model, const Remainder& remainder,
                                 std::string_view effort) {
  std::vector<MisfitTest> tests;
  const Eigen::VectorXd residuals = design.residuals(model.fit);
  const double torque = std::sqrt(mean_square(design, design.raw(model.fit.target), false));
  const double relative = std::sqrt(mean_square(design, residuals, false)) / torque;
  tests.push_back({"relative torque error", relative, std::numeric_limits<double>::quiet_NaN(),
                   fmt::format("{:.2f} % of the {} is left", 100.0 * relative, effort)});
  const double rows = design.fitted_rows();
  const double z = remainder.correlation * std::sqrt(rows);
  const double p = statistics::chi_squared_p_value(z * z, 1.0);
  tests.push_back({"whiteness of the torque", remainder.correlation, p,
                   remainder.correlation < kWhite
                       ? "neighbouring rows are left unlike each other, as by noise"
                       : "what is left is smooth in time"});
  tests.push_back({"noise of the readings", remainder.noise, std::numeric_limits<double>::quiet_NaN(),
                   fmt::format("{:.3g} is left, {:.3g} would be the readings' own noise", remainder.left,
                               remainder.noise)});
  return tests;
}

}  // namespace clampd::drive
