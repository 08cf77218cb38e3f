#include "src/diagnose/residuals.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include "clampd/base/parallel.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/diagnose/evidence.hpp"

namespace clampd::diagnosing {

namespace {

constexpr int kLags = 20;
constexpr int kCrossLags = 5;
constexpr std::size_t kWanderRows = 256;
constexpr int kKnots = 6;
/// A reading with steps repeats its values: so many distinct ones at most.
constexpr double kDistinct = 0.3;
/// Steps from so many standard deviations of the noise on are coarser than it; what they do is then no noise.
constexpr double kCoarse = 1.0;
/// By chance, a reading that was never held is further off where it repeats itself.
constexpr double kHeld = 1e-3;
/// Shapes of which less than this share is left when the parameters follow are not told from them.
constexpr double kIdentifiable = 1e-2;
/// The same of directions among shapes.
constexpr double kDistinctFromZero = 1e-3;

/// Chi-square with so many degrees where innovations are white.
struct Correlation {
  double statistic = 0.0;
  double degrees = 0.0;
};
/// Sum over lags of n rho^2 of two series of innovations, runs put together.
Correlation correlation(std::span<const FilteredRun> runs, bool force_first, bool force_second, int first_lag,
                        int last_lag) {
  Correlation result;
  for (int lag = first_lag; lag <= last_lag; ++lag) {
    double product = 0.0, square_a = 0.0, square_b = 0.0, count = 0.0;
    for (const FilteredRun& run : runs) {
      const std::vector<double>& a = force_first ? run.force : run.velocity;
      const std::vector<double>& b = force_second ? run.force : run.velocity;
      const auto size = static_cast<int>(a.size());
      for (int k = std::max(0, -lag); k < std::min(size, size - lag); ++k) {
        const double x = a[static_cast<std::size_t>(k)];
        const double y = b[static_cast<std::size_t>(k + lag)];
        if (!std::isfinite(x) || !std::isfinite(y)) continue;
        product += x * y;
        square_a += x * x;
        square_b += y * y;
        count += 1.0;
      }
    }
    if (!(square_a > 0.0) || !(square_b > 0.0)) continue;
    result.statistic += count * product * product / (square_a * square_b);
    result.degrees += 1.0;
  }
  return result;
}

/// Whether innovations keep their sign for long: what wanders slowly is too faint to show from row to row.
Correlation wander(std::span<const FilteredRun> runs, bool force) {
  Correlation result;
  for (const FilteredRun& run : runs) {
    const std::vector<double>& z = force ? run.force : run.velocity;
    const std::size_t stretches = std::max<std::size_t>(1, (z.size() + kWanderRows / 2) / kWanderRows);
    for (std::size_t i = 0; i < stretches; ++i) {
      double sum = 0.0, count = 0.0;
      for (std::size_t k = i * z.size() / stretches; k < (i + 1) * z.size() / stretches; ++k) {
        if (!std::isfinite(z[k])) continue;
        sum += z[k];
        count += 1.0;
      }
      if (count == 0.0) continue;
      result.statistic += sum * sum / count;
      result.degrees += 1.0;
    }
  }
  return result;
}

/// The step of a reading that has one; zero if its values lie anywhere.
double step_of(std::span<const FitRun> data, bool force) {
  std::vector<double> values;
  for (const FitRun& run : data) {
    const std::vector<double>& channel = force ? run.force_N : run.velocity_rad_s;
    values.insert(values.end(), channel.begin(), channel.end());
  }
  const double readings = static_cast<double>(values.size());
  std::sort(values.begin(), values.end());
  values.erase(
      std::unique(values.begin(), values.end(),
                  [](double a, double b) { return std::abs(a - b) <= 1e-9 * std::max(1.0, std::abs(a)); }),
      values.end());
  if (values.size() < 3 || static_cast<double>(values.size()) > kDistinct * readings) return 0.0;
  double step = values.back() - values.front();
  for (std::size_t i = 1; i < values.size(); ++i) step = std::min(step, values[i] - values[i - 1]);
  std::size_t off = 0;
  for (std::size_t i = 1; i < values.size(); ++i) {
    const double steps = (values[i] - values[i - 1]) / step;
    off += std::abs(steps - std::round(steps)) > 0.05;
  }
  return off * 50 < values.size() ? step : 0.0;
}

/// Whether the model is missed where a reading is the very one of the row before: then it was held, and not
/// taken anew. Values that come back elsewhere are a reading's resolution, a limit or standstill instead.
Correlation held_readings(std::span<const FilteredRun> runs, std::span<const FitRun> data, bool force) {
  struct Stretch {
    double value;
    std::size_t run, first, rows;
  };
  std::vector<Stretch> stretches;
  for (std::size_t r = 0; r < data.size(); ++r) {
    const std::vector<double>& reading = force ? data[r].force_N : data[r].velocity_rad_s;
    for (std::size_t k = 0; k < reading.size(); ++k) {
      if (k > 0 && reading[k] == reading[k - 1])
        ++stretches.back().rows;
      else
        stretches.push_back({reading[k], r, k, 1});
    }
  }
  std::sort(stretches.begin(), stretches.end(),
            [](const Stretch& a, const Stretch& b) { return a.value < b.value; });
  Correlation result;
  std::size_t held = 0, come_back = 0;
  for (std::size_t i = 0; i < stretches.size();) {
    std::size_t next = i + 1;
    while (next < stretches.size() && stretches[next].value == stretches[i].value) ++next;
    const Stretch& stretch = stretches[i];
    if (next > i + 1) {
      ++come_back;
    } else if (stretch.rows > 1) {
      ++held;
      const std::vector<double>& z = force ? runs[stretch.run].force : runs[stretch.run].velocity;
      for (std::size_t k = stretch.first + 1; k < stretch.first + stretch.rows; ++k) {
        if (!std::isfinite(z[k])) continue;
        result.statistic += z[k] * z[k];
        result.degrees += 1.0;
      }
    }
    i = next;
  }
  // With a resolution values come back elsewhere much more often than in the next row.
  return held > come_back ? result : Correlation{};
}

/// Whether innovations are larger where something changes fast.
Correlation spread_against_rates(std::span<const FilteredRun> runs, std::span<const FitRun> data,
                                 bool force) {
  std::vector<Eigen::Vector4d> rows;
  std::vector<double> squares;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const FilteredRun& run = runs[r];
    const std::vector<double>& z = force ? run.force : run.velocity;
    for (std::size_t k = 1; k < z.size(); ++k) {
      if (!std::isfinite(z[k])) continue;
      const double gap = data[r].time_s[k] - data[r].time_s[k - 1];
      rows.emplace_back(1.0, std::abs(run.true_velocity_rad_s[k]),
                        std::abs(run.predicted_force_N[k] - run.predicted_force_N[k - 1]) / gap,
                        std::abs(run.true_velocity_rad_s[k] - run.true_velocity_rad_s[k - 1]) / gap);
      squares.push_back(z[k] * z[k]);
    }
  }
  if (rows.size() < 50) return {};
  const auto count = static_cast<double>(rows.size());
  double mean = 0.0, fourth = 0.0;
  for (const double square : squares) {
    mean += square / count;
    fourth += square * square / count;
  }
  const double variance = std::max(1e-12, fourth - mean * mean);  // of a square; robust to heavy tails
  Eigen::Vector4d scale = Eigen::Vector4d::Zero();
  for (const auto& row : rows) scale = scale.cwiseMax(row);
  Eigen::Matrix4d information = Eigen::Matrix4d::Zero();
  Eigen::Vector4d score = Eigen::Vector4d::Zero();
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Eigen::Vector4d row = rows[i].cwiseQuotient(scale.cwiseMax(1e-9));
    information += row * row.transpose();
    score += row * (squares[i] - mean);
  }
  information.diagonal().array() += 1e-9 * count;
  return {score.dot(statistics::SymmetricFactor(information).solve(score)) / variance, 3.0};
}

/// Repeats of one manoeuvre: what they have in common against what they differ by. Needs no noise model.
struct LackOfFit {
  double between = 0.0, within = 0.0, degrees_between = 0.0, degrees_within = 0.0;
};
LackOfFit lack_of_fit(std::span<const FilteredRun> runs, std::span<const FitRun> data) {
  LackOfFit result;
  std::vector<bool> taken(runs.size(), false);
  for (std::size_t first = 0; first < runs.size(); ++first) {
    if (taken[first]) continue;
    std::vector<std::size_t> group;
    for (std::size_t r = first; r < runs.size(); ++r) {
      if (taken[r] || data[r].size() != data[first].size()) continue;
      const Eigen::Map<const Eigen::VectorXd> a(data[first].torque_Nm.data(),
                                                static_cast<Eigen::Index>(data[first].size()));
      const Eigen::Map<const Eigen::VectorXd> b(data[r].torque_Nm.data(),
                                                static_cast<Eigen::Index>(data[r].size()));
      const double norms = (a.array() - a.mean()).matrix().norm() * (b.array() - b.mean()).matrix().norm();
      if (r != first && !((a.array() - a.mean()).matrix().dot((b.array() - b.mean()).matrix()) > 0.9 * norms))
        continue;
      group.push_back(r);
      taken[r] = true;
    }
    if (group.size() < 2) continue;
    const auto repeats = static_cast<double>(group.size());
    for (std::size_t k = 0; k < data[first].size(); ++k)
      for (const bool force : {true, false}) {
        double mean = 0.0, square = 0.0;
        bool complete = true;
        for (const std::size_t r : group) {
          const double z = force ? runs[r].force[k] : runs[r].velocity[k];
          complete = complete && std::isfinite(z);
          mean += z / repeats;
          square += z * z;
        }
        if (!complete) continue;
        result.between += repeats * mean * mean;
        result.within += square - repeats * mean * mean;
        result.degrees_between += 1.0;
        result.degrees_within += repeats - 1.0;
      }
  }
  return result;
}

/// A variable of the motion, and the free functions of it that could be missing.
struct Variable {
  std::string name;
  std::vector<std::vector<double>> values;  ///< per run, per row
  enum class Shape { Bends, Constant, Runs } shape = Shape::Bends;
};

std::vector<Variable> variables_of(std::span<const FilteredRun> filtered, std::span<const FitRun> runs) {
  std::vector<Variable> list(7);
  const char* const names[] = {"position", "velocity", "force", "time", "torque", "direction", "run"};
  for (std::size_t v = 0; v < list.size(); ++v) list[v].name = names[v];
  list[5].shape = Variable::Shape::Constant;
  list[6].shape = Variable::Shape::Runs;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const FilteredRun& run = filtered[r];
    list[0].values.push_back(run.position_rad);
    list[1].values.push_back(run.true_velocity_rad_s);
    list[2].values.push_back(run.predicted_force_N);
    std::vector<double> time(runs[r].time_s), direction(time.size()), number(time.size(), runs[r].number);
    for (double& t : time) t -= runs[r].time_s.front();
    for (std::size_t k = 0; k < direction.size(); ++k)
      direction[k] = run.true_velocity_rad_s[k] > 0.0 ? 1.0 : run.true_velocity_rad_s[k] < 0.0 ? -1.0 : 0.0;
    list[3].values.push_back(std::move(time));
    list[4].values.push_back(runs[r].torque_Nm);
    list[5].values.push_back(std::move(direction));
    list[6].values.push_back(std::move(number));
  }
  return list;
}

/// Columns of a free function: piecewise linear between quantiles.
std::vector<Eigen::MatrixXd> columns_of(const Variable& variable) {
  std::vector<Eigen::MatrixXd> columns;
  if (variable.shape == Variable::Shape::Runs) {
    for (std::size_t r = 0; r < variable.values.size(); ++r) {
      Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(variable.values[r].size()),
                                                   static_cast<Eigen::Index>(variable.values.size()));
      rows.col(static_cast<Eigen::Index>(r)).setOnes();
      columns.push_back(std::move(rows));
    }
    return columns;
  }
  if (variable.shape == Variable::Shape::Constant) {
    for (const std::vector<double>& values : variable.values) {
      Eigen::MatrixXd rows(static_cast<Eigen::Index>(values.size()), 2);
      for (std::size_t k = 0; k < values.size(); ++k) {
        rows(static_cast<Eigen::Index>(k), 0) = values[k] > 0.0;
        rows(static_cast<Eigen::Index>(k), 1) = values[k] < 0.0;
      }
      columns.push_back(std::move(rows));
    }
    return columns;
  }
  std::vector<double> all;
  for (const std::vector<double>& values : variable.values)
    all.insert(all.end(), values.begin(), values.end());
  std::sort(all.begin(), all.end());
  // Half way between equal shares of the rows and equal distances: rare extremes matter, too.
  std::array<double, kKnots> knots;
  for (int i = 0; i < kKnots; ++i) {
    const double share = static_cast<double>(i) / (kKnots - 1);
    knots[static_cast<std::size_t>(i)] =
        0.5 * (all[static_cast<std::size_t>(share * static_cast<double>(all.size() - 1))] + all.front() +
               share * (all.back() - all.front()));
  }
  for (const std::vector<double>& values : variable.values) {
    Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(values.size()), kKnots);
    for (std::size_t k = 0; k < values.size(); ++k) {
      const auto above = std::upper_bound(knots.begin(), knots.end(), values[k]);
      const auto right = std::clamp<std::ptrdiff_t>(above - knots.begin(), 1, kKnots - 1);
      const double left = knots[static_cast<std::size_t>(right - 1)];
      const double width = knots[static_cast<std::size_t>(right)] - left;
      const double share = width > 0.0 ? std::clamp((values[k] - left) / width, 0.0, 1.0) : 0.0;
      rows(static_cast<Eigen::Index>(k), right - 1) = 1.0 - share;
      rows(static_cast<Eigen::Index>(k), right) = share;
    }
    columns.push_back(std::move(rows));
  }
  return columns;
}

/// The torque read before each row: the newest that may explain a reading taken at that row. A controller may
/// have computed the torque of the row itself from that very reading, its noise included.
std::vector<Eigen::MatrixXd> previous_torque(std::span<const FitRun> runs) {
  Variable torque{"torque", {}};
  for (const FitRun& run : runs) {
    std::vector<double> before(run.torque_Nm);
    for (std::size_t k = 1; k < before.size(); ++k) before[k] = run.torque_Nm[k - 1];
    torque.values.push_back(std::move(before));
  }
  return columns_of(torque);
}

/// Rates of the readings: what a channel that comes too late or too early lacks. Differences to the row
/// before: what comes after a row was predicted, or commanded, from that row's readings.
std::vector<Eigen::MatrixXd> rates_of(std::span<const FilteredRun> filtered, std::span<const FitRun> runs,
                                      SignalColumns::Kind kind) {
  std::vector<Eigen::MatrixXd> columns;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const std::vector<double>& signal =
        kind == SignalColumns::Kind::ForceReading      ? filtered[r].predicted_force_N
        : kind == SignalColumns::Kind::VelocityReading ? filtered[r].true_velocity_rad_s
                                                       : runs[r].torque_Nm;
    Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(signal.size()), 1);
    for (std::size_t k = 1; k < signal.size(); ++k)
      rows(static_cast<Eigen::Index>(k), 0) =
          (signal[k] - signal[k - 1]) / (runs[r].time_s[k] - runs[r].time_s[k - 1]) * 1e-3;
    columns.push_back(std::move(rows));
  }
  return columns;
}

double readings_of(std::span<const FitRun> runs) {
  double count = 0.0;
  for (const FitRun& run : runs) count += static_cast<double>(run.size());
  return count;
}

struct Question {
  SignalColumns::Kind kind;
  std::string variable;
  Location location;
  std::vector<Eigen::MatrixXd> columns;
};

Location location_of(SignalColumns::Kind kind, const std::string& variable) {
  switch (kind) {
    case SignalColumns::Kind::Torque:
      return variable == "torque" ? Location::TorqueReading : Location::TorqueBalance;
    case SignalColumns::Kind::Force:
      return Location::Stiffness;
    case SignalColumns::Kind::ForceReading:
      return Location::ForceReading;
    case SignalColumns::Kind::VelocityReading:
      return Location::VelocityReading;
  }
  return Location::TorqueBalance;
}

struct Answer {
  double gain = 0.0;
  double degrees = 0.0;
};

/// Only in directions that the data tell from the parameters and from each other.
Answer gain_of(const SignalScores& scores, Eigen::Index first, Eigen::Index count) {
  std::vector<Eigen::Index> identifiable;
  for (Eigen::Index i = first; i < first + count; ++i)
    if (scores.information(i, i) > kIdentifiable * scores.alone[i] && scores.alone[i] > 0.0)
      identifiable.push_back(i);
  Answer answer;
  if (identifiable.empty()) return answer;
  const Eigen::MatrixXd information = scores.information(identifiable, identifiable);
  const Eigen::VectorXd scale = information.diagonal().cwiseSqrt();
  const statistics::Spectrum spectrum = statistics::spectrum_of(statistics::scaled_by(information, scale));
  const Eigen::VectorXd along =
      spectrum.vectors.transpose() * scores.score(identifiable).cwiseQuotient(scale);
  for (Eigen::Index i = 0; i < along.size(); ++i) {
    if (!(spectrum.values[i] > kDistinctFromZero)) continue;
    answer.gain += 0.5 * along[i] * along[i] / spectrum.values[i];
    answer.degrees += 1.0;
  }
  return answer;
}

/// What one test or dependence says.
struct Finding {
  double neg_log_p;  ///< -ln p
  double nats;       ///< what a model of it would gain
};

/// The tests of the residuals as they are carried out, and what each of them found.
struct Examination {
  Residuals residuals;
  std::vector<Finding> findings;
  double failed_most = 0.0;

  /// A chi-square test of innovations; `passed` and `failed` are its words.
  void add_test(std::string name, Location location, const Correlation& found, const char* passed,
                const char* failed) {
    if (!(found.degrees > 0.0)) return;
    const double neg_log_p = neg_log_p_of_chi_square(found.statistic, found.degrees);
    const double p = p_value_of(neg_log_p);
    residuals.tests.push_back({std::move(name), found.statistic, p, p < 1e-3 ? failed : passed});
    findings.push_back({neg_log_p, std::max(0.0, 0.5 * (found.statistic - found.degrees))});
    if (neg_log_p <= failed_most) return;
    failed_most = neg_log_p;
    residuals.hint = location;
  }
};

/// Whether the innovations are white, uncorrelated with each other, and equally large everywhere.
void test_innovations(std::span<const FilteredRun> filtered, std::span<const FitRun> runs,
                      Examination& examination) {
  examination.add_test("whiteness of the force", Location::ForceReading,
                       correlation(filtered, true, true, 1, kLags), "the force residual is white",
                       "the force residual is autocorrelated");
  examination.add_test("whiteness of the velocity", Location::TorqueBalance,
                       correlation(filtered, false, false, 1, kLags), "the velocity residual is white",
                       "the velocity residual is autocorrelated");
  examination.add_test("force against velocity", Location::Timing,
                       correlation(filtered, true, false, -kCrossLags, kCrossLags),
                       "the residuals of force and velocity are uncorrelated",
                       "the residuals of force and velocity are correlated: one of the readings comes late, "
                       "or the balance lacks something");
  examination.add_test("wander of the force", Location::ForceReading, wander(filtered, true),
                       "the force residual does not wander",
                       "the force residual is to one side for hundreds of rows, then to the other");
  examination.add_test("wander of the velocity", Location::TorqueBalance, wander(filtered, false),
                       "the velocity residual does not wander",
                       "the velocity residual is to one side for hundreds of rows, then to the other: a "
                       "torque that changes by itself");
  examination.add_test("spread of the force", Location::Timing, spread_against_rates(filtered, runs, true),
                       "the force is equally uncertain everywhere",
                       "the force is more uncertain where something changes fast");
  examination.add_test("spread of the velocity", Location::Timing,
                       spread_against_rates(filtered, runs, false),
                       "the velocity is equally uncertain everywhere",
                       "the velocity is more uncertain where something changes fast");
}

/// A reading, and what was found where it repeats the row before.
struct Held {
  Location location;
  Correlation found;
};

std::array<Held, 2> test_held_readings(std::span<const FilteredRun> filtered, std::span<const FitRun> runs,
                                       Examination& examination) {
  const std::array<Held, 2> held{Held{Location::ForceReading, held_readings(filtered, runs, true)},
                                 Held{Location::VelocityReading, held_readings(filtered, runs, false)}};
  for (const Held& reading : held)
    examination.add_test(
        fmt::format("repeats of the {}", reading.location == Location::ForceReading ? "force" : "velocity"),
        reading.location, reading.found,
        "where it reads the very same as a row before, it is no further off than elsewhere",
        "where it reads the very same as a row before, it is off: its last value was held");
  return held;
}

void test_repeats(std::span<const FilteredRun> filtered, std::span<const FitRun> runs,
                  Examination& examination) {
  const LackOfFit repeats = lack_of_fit(filtered, runs);
  if (!(repeats.degrees_within > 50.0) || !(repeats.within > 0.0)) return;
  const double f = repeats.between / repeats.degrees_between / (repeats.within / repeats.degrees_within);
  const double neg_log_p = neg_log_p_of_f(f, repeats.degrees_between, repeats.degrees_within);
  examination.residuals.tests.push_back({"lack of fit against repeats", f, p_value_of(neg_log_p),
                                         neg_log_p > 7.0
                                             ? "repeats miss the model in the same places"
                                             : "repeats miss the model no more alike than by chance"});
  examination.findings.push_back({neg_log_p, std::max(0.0, 0.5 * (f - 1.0) * repeats.degrees_between)});
}

/// Whether a reading's steps are coarser than its noise.
void test_resolution(const Hypothesis& hypothesis, Examination& examination) {
  for (const bool force : {true, false}) {
    const double step = step_of(hypothesis.runs, force);
    const double noise =
        force ? hypothesis.estimate.noise.sensors.force_N : hypothesis.estimate.noise.sensors.velocity_rad_s;
    if (!(step > 0.0)) continue;
    const bool coarse = step > kCoarse * noise;
    const char* const name = force ? "force" : "velocity";
    examination.residuals.tests.push_back(
        {fmt::format("resolution of the {}", name), step, coarse ? 0.0 : 1.0,
         fmt::format("the reading of {} has steps of {:.3g} {}, {} than its noise", name, step,
                     force ? "N" : "rad/s", coarse ? "coarser" : "finer")});
    if (!coarse) continue;
    const double nats = readings_of(hypothesis.runs) * step * step / (24.0 * noise * noise);
    examination.findings.push_back({nats, nats});
    examination.residuals.dependences.push_back(
        {name, force ? Location::ForceReading : Location::VelocityReading, nats, 0.0});
  }
}

constexpr std::array kKinds{SignalColumns::Kind::Torque, SignalColumns::Kind::Force,
                            SignalColumns::Kind::ForceReading, SignalColumns::Kind::VelocityReading};

/// Every variable of the motion in every place where something may be missing.
std::vector<Question> questions_about(std::span<const FilteredRun> filtered, std::span<const FitRun> runs) {
  using Kind = SignalColumns::Kind;
  const std::vector<Variable> variables = variables_of(filtered, runs);
  std::vector<Question> questions;
  for (const Kind kind : kKinds) {
    for (const Variable& variable : variables) {
      if (variable.shape == Variable::Shape::Runs &&
          (variable.values.size() < 2 || variable.values.size() > 60))
        continue;
      // A torque acts from its row until the next one: what it drives is read after it.
      const bool is_read_with_it = variable.name == "torque" && kind != Kind::Torque;
      questions.push_back({kind, variable.name, location_of(kind, variable.name),
                           is_read_with_it ? previous_torque(runs) : columns_of(variable)});
    }
    if (kind != Kind::Force)
      questions.push_back({kind, "rate", Location::Timing, rates_of(filtered, runs, kind)});
  }
  return questions;
}

/// One pass a kind: the columns of all its questions side by side.
std::vector<Answer> answers_to(std::span<const Question> questions, const Hypothesis& hypothesis) {
  std::vector<Answer> answers(questions.size());
  const SignalScorer scorer(hypothesis.runs, hypothesis.estimate, hypothesis.threads);
  for_each_index(kKinds.size(), hypothesis.threads, [&](std::size_t i) {
    SignalColumns signals{kKinds[i], {}};
    std::vector<std::size_t> members;
    Eigen::Index width = 0;
    for (std::size_t q = 0; q < questions.size(); ++q) {
      if (questions[q].kind != kKinds[i]) continue;
      members.push_back(q);
      width += questions[q].columns.front().cols();
    }
    for (std::size_t r = 0; r < hypothesis.runs.size(); ++r) {
      Eigen::MatrixXd rows(questions[members.front()].columns[r].rows(), width);
      Eigen::Index at = 0;
      for (const std::size_t q : members) {
        rows.middleCols(at, questions[q].columns[r].cols()) = questions[q].columns[r];
        at += questions[q].columns[r].cols();
      }
      signals.rows.push_back(std::move(rows));
    }
    const SignalScores scores = scorer.score(signals);
    Eigen::Index at = 0;
    for (const std::size_t q : members) {
      const Eigen::Index count = questions[q].columns.front().cols();
      answers[q] = gain_of(scores, at, count);
      at += count;
    }
  });
  return answers;
}

}  // namespace

double neg_log_p_of_colour(std::span<const FilteredRun> runs) {
  const Correlation force = correlation(runs, true, true, 1, kLags);
  const Correlation velocity = correlation(runs, false, false, 1, kLags);
  return neg_log_p_of_chi_square(force.statistic + velocity.statistic, force.degrees + velocity.degrees);
}

Residuals examine(const Hypothesis& hypothesis) {
  const std::vector<FilteredRun> filtered =
      filter_runs(hypothesis.runs, hypothesis.estimate, hypothesis.threads);
  if (filtered.empty()) return {};

  Examination examination;
  test_innovations(filtered, hypothesis.runs, examination);
  const std::array<Held, 2> held = test_held_readings(filtered, hypothesis.runs, examination);
  test_repeats(filtered, hypothesis.runs, examination);
  test_resolution(hypothesis, examination);
  const std::vector<Question> questions = questions_about(filtered, hypothesis.runs);
  const std::vector<Answer> answers = answers_to(questions, hypothesis);

  Residuals& residuals = examination.residuals;
  const auto tried = static_cast<double>(questions.size() + examination.findings.size());
  const auto surprise_of = [&](std::size_t q) {
    return neg_log_p_of_chi_square(2.0 * answers[q].gain, answers[q].degrees);
  };
  // A reading that is held shows in all else, too, but comes from nothing else: it is told first.
  for (const Held& reading : held) {
    const double neg_log_p = neg_log_p_of_chi_square(reading.found.statistic, reading.found.degrees);
    const double p = p_value_of(neg_log_p, tried);
    if (p < kHeld)
      residuals.dependences.push_back({std::string(kRepetition), reading.location,
                                       0.5 * (reading.found.statistic - reading.found.degrees), p});
  }
  // By how surprising: a free function of more shapes gains more by chance.
  std::vector<std::size_t> order(questions.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return surprise_of(a) > surprise_of(b); });
  for (const std::size_t q : order) {
    examination.findings.push_back(
        {surprise_of(q), std::max(0.0, answers[q].gain - 0.5 * answers[q].degrees)});
    residuals.dependences.push_back(
        {questions[q].variable, questions[q].location, answers[q].gain, p_value_of(surprise_of(q), tried)});
  }
  for (const Finding& finding : examination.findings) {
    residuals.neg_log_p = std::max(residuals.neg_log_p, finding.neg_log_p - std::log(tried));
    if (finding.neg_log_p - std::log(tried) > 4.6) residuals.nats = std::max(residuals.nats, finding.nats);
  }
  return residuals;
}

}  // namespace clampd::diagnosing
