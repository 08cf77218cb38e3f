#include "clampd/identify/extended_fit.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <utility>

#include "clampd/base/assert.hpp"
#include "clampd/identify/prediction_error.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/extended_run.hpp"
#include "src/identify/fit_of_runs.hpp"
#include "src/identify/starting_point.hpp"

namespace clampd {

namespace identify {

namespace {

/// Gains and noise are renewed until the noise's standard deviations change by less than this share.
constexpr double kExtendedNoiseTolerance = 0.01;
constexpr double kNegligibleExtendedTorque = 1e-7;  // a variance
constexpr int kMaxRounds = 12;
constexpr int kNoiseIterations = 6;
/// After so many it is seen whether a fit is hopeless: further from where it is wanted than so many steps as
/// the next one would take it.
constexpr int kHopelessIterations = 6;
constexpr double kHopelessSteps = 4.0;

/// Below this much torque noise (N m) nothing changes any more.
constexpr double kSmallestTorque_Nm = 2e-5;

/// No step takes a positive parameter further than to its double or half.
double limited(double logarithmic_step) {
  return std::clamp(logarithmic_step, -0.7, 0.7);
}

/// Some of a fit's unknowns: parameters, and initial_states of each run.
struct Part {
  std::vector<Eigen::Index> parameters;
  std::vector<int> initial_states;
};

/// A model that is simulated, beside its parameters.
struct SimulatedModel {
  explicit SimulatedModel(ExtendedParameters values) : parameters(std::move(values)), brake(parameters) {}
  ExtendedParameters parameters;
  ExtendedBrake brake;
};

/// The innovations of any model, as JointFit of the paper's brake.
class ExtendedFit : public FitOfRuns<ExtendedFit, FitRun, ExtendedRun, Eigen::MatrixXd, Eigen::VectorXd> {
 public:
  ExtendedFit(std::span<const FitRun> runs, const ExtendedEstimate& start,
              const std::array<bool, kParameterCount>& held, const ThreadBudget& threads = {},
              bool hold_effects = false)
      : FitOfRuns(runs, threads),
        model_(start.parameters),
        shape_(start.parameters),
        unknowns_(model_, shape_.places(), held, hold_effects),
        starts_(start.initial_states) {
    const std::vector<double> prior = prior_deviations(model_);
    const auto initial_states = static_cast<int>(prior.size());
    const int parameters = unknowns_.count();
    set_size(parameters, prior, parameters + initial_states + 1, [&](const FitRun& run, ExtendedRun& linear) {
      linear.resize(run.size(), shape_.states(), parameters, initial_states);
    });
    for (int local = 2; const EffectValues& effect : model_.effects) {
      const EffectInfo& info = info_of(*effect.effect);
      for (int i = 0; i < info.free_states; ++i, ++local)
        if (!info.free_states_count) drawn_.push_back(local);
    }
    CLAMPD_ASSERT(starts_.size() == runs.size());
    for (std::size_t r = 0; r < runs.size(); ++r) {
      CLAMPD_ASSERT(starts_[r].size() == initial_states);
      // Free states are near their settled value, wherever the search begins.
      centres_[r].head<2>() = starts_[r].head<2>();
    }
  }

  bool operator()(const double* unknowns, double* residuals, double* jacobian) const {
    FitOfRuns::operator()(unknowns, residuals, jacobian);
    if (jacobian == nullptr || !now_.possible) return true;
    Eigen::Map<Eigen::MatrixXd> columns(jacobian, NumResiduals(), NumParameters());
    for (const Eigen::Index i : joint_step().held) columns.col(i).setZero();
    return true;
  }
  bool evaluate(const Point& anywhere) const { return FitOfRuns::evaluate(inside(anywhere)); }

  Eigen::VectorXd start() const {
    Eigen::VectorXd point(NumParameters());
    for (int i = 0; i < parameters_; ++i) point[i] = unknowns_.from(model_, i);
    for (std::size_t r = 0; r < runs_.size(); ++r) point.segment(first_of(r), initial_states_) = starts_[r];
    return point;
  }

  ExtendedParameters parameters_at(const Point& point) const {
    ExtendedParameters model = model_;
    for (int i = 0; i < parameters_; ++i) unknowns_.put(point[i], i, model);
    return model;
  }
  std::vector<Eigen::VectorXd> initial_at(const Eigen::VectorXd& point) const {
    std::vector<Eigen::VectorXd> initial;
    for (std::size_t r = 0; r < runs_.size(); ++r) initial.push_back(initial_of(point, r));
    return initial;
  }

  /// The gains of extended Kalman filters at this point from here on; it is evaluated then.
  bool use_innovations(const Point& point, const Variances& variances) {
    invalidate();
    const auto filter = [&](const SimulatedModel& model, std::size_t r, const Eigen::VectorXd& initial,
                            ExtendedRun& linear) {
      return linearise(runs_[r], model.brake, model.parameters, unknowns_, initial, variances, Gains::Renewed,
                       linear);
    };
    if (!linearise_at(inside(point), filter)) return false;
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      before_.linear[r].gain = now_.linear[r].gain;
      before_.linear[r].variance = now_.linear[r].variance;
    }
    return true;
  }

  /// The nearest point within the parameters' bounds, which a search may ask beyond of: there the model is
  /// the one at the bound.
  Eigen::VectorXd inside(Eigen::VectorXd point) const {
    for (int i = 0; i < parameters_; ++i)
      point[i] = std::clamp(point[i], unknowns_.lower(i), unknowns_.upper(i));
    return point;
  }

  double log_likelihood() const { return log_likelihood(everything()); }
  /// Of the model that has only a part of the initial_states.
  double log_likelihood(const Part& part) const {
    double sum = sum_of_squares();
    for (const ExtendedRun& run : now_.linear)
      sum += run.log_determinant + run.readings * std::log(2.0 * std::numbers::pi);
    for (const Eigen::MatrixXd& normal : now_.normals)
      sum += cost_of_drawn_states(normal, part.initial_states);
    return -0.5 * sum;
  }
  double readings() const {
    double sum = 0.0;
    for (const ExtendedRun& run : now_.linear) sum += run.readings;
    return sum;
  }

  /// A run's, its initial state eliminated.
  Reduced reduced(std::size_t run) const {
    return without_initial_states(now_.normals[run], parameters_, initial_states_);
  }

  /// Of all runs.
  Reduced joint() const { return joint(everything()); }
  /// The same if there were no other parameters and initial_states.
  Reduced joint(const Part& part) const {
    const auto count = static_cast<Eigen::Index>(part.parameters.size());
    std::vector<Eigen::Index> which = part.parameters;
    for (const int local : part.initial_states) which.push_back(parameters_ + local);
    which.push_back(parameters_ + initial_states_);
    Reduced joint{Eigen::MatrixXd::Zero(count, count), Eigen::VectorXd::Zero(count)};
    for (const Eigen::MatrixXd& normal : now_.normals) {
      const Reduced run = without_initial_states(normal(which, which), static_cast<int>(count),
                                                 static_cast<int>(part.initial_states.size()));
      joint.information += run.information;
      joint.gradient += run.gradient;
      joint.sum_of_squares += run.sum_of_squares;
    }
    return joint;
  }

  /// Gauss-Newton step of a part's parameters within their bounds, the initial_states following: those at a
  /// bound that the others would take beyond stay, and the others go where they then go.
  struct Step {
    Eigen::VectorXd move;
    std::vector<Eigen::Index> held;  ///< of the part's parameters; `move` has the way that they would go
    double decrease;                 ///< of the squares
  };
  Step step_of(const Part& part, const Reduced& joint) const {
    Step step{-solve(joint.information, joint.gradient), {}, 0.0};
    std::vector<Eigen::Index> left;
    for (Eigen::Index i = 0; i < step.move.size(); ++i) {
      const int unknown = static_cast<int>(part.parameters[static_cast<std::size_t>(i)]);
      const double value = now_.point[unknown];
      const bool outward = (step.move[i] < 0.0 && value <= unknowns_.lower(unknown)) ||
                           (step.move[i] > 0.0 && value >= unknowns_.upper(unknown));
      (outward ? step.held : left).push_back(i);
    }
    if (!step.held.empty()) {
      const Eigen::VectorXd gradient = joint.gradient(left);
      step.move(left) = -solve(joint.information(left, left), gradient);
      step.decrease = sum_of_squares() - joint.sum_of_squares - gradient.dot(step.move(left));
    } else {
      step.decrease = sum_of_squares() - joint.sum_of_squares - joint.gradient.dot(step.move);
    }
    return step;
  }
  Step joint_step() const {
    const Part all = everything();
    return step_of(all, joint(all));
  }

  double expected_decrease() const { return joint_step().decrease; }

  void gauss_newton_step(Eigen::VectorXd& step) const {
    Step all = joint_step();
    for (const Eigen::Index i : all.held) all.move[i] = 0.0;
    const Eigen::VectorXd& move = all.move;
    step.resize(NumParameters());
    for (int i = 0; i < parameters_; ++i) step[i] = unknowns_.is_logarithmic(i) ? limited(move[i]) : move[i];
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      const Eigen::MatrixXd& normal = now_.normals[r];
      step.segment(first_of(r), initial_states_) =
          -statistics::SymmetricFactor(
               normal.block(parameters_, parameters_, initial_states_, initial_states_))
               .solve(normal.block(parameters_, parameters_ + initial_states_, initial_states_, 1) +
                      normal.block(parameters_, 0, initial_states_, parameters_) * move);
    }
  }

  /// Maximum likelihood of the noise for the rows as they are; leaves the gains to be renewed.
  Variances estimate_noise(Variances variances, int iterations) {
    std::vector<NoiseSquares> parts(runs_.size());
    for (int i = 0; i < iterations; ++i) {
      for_each_run([&](std::size_t r) {
        std::vector<double> innovation;
        recompute_gains(runs_[r], variances, now_.linear[r], innovation);
        parts[r] = smooth(runs_[r], now_.linear[r], innovation, nullptr);
      });
      NoiseSquares sum;
      for (const NoiseSquares& part : parts) {
        sum.force += part.force;
        sum.force_expected += part.force_expected;
        sum.velocity += part.velocity;
        sum.velocity_expected += part.velocity_expected;
        sum.torque += part.torque;
        sum.torque_expected += part.torque_expected;
      }
      const auto renewed = [](double variance, double square, double expected, double smallest,
                              double power) {
        if (!(expected > 0.0)) return variance;
        const double ratio = std::clamp(square / expected, 0.05, 20.0);
        return std::max(smallest * smallest, variance * std::pow(ratio, power));
      };
      const Variances before = variances;
      variances.force = renewed(variances.force, sum.force, sum.force_expected, kSmallestNoise.force_N, 1.0);
      variances.velocity = renewed(variances.velocity, sum.velocity, sum.velocity_expected,
                                   kSmallestNoise.velocity_rad_s, 1.0);
      // The torque's noise shows through the readings' only: this rule's steps are then too small.
      variances.torque = renewed(variances.torque, sum.torque, sum.torque_expected, kSmallestTorque_Nm, 1.6);
      if (change_between(before, variances, kNegligibleExtendedTorque) < 0.5 * kExtendedNoiseTolerance) break;
    }
    invalidate();
    return variances;
  }

  /// Directions that the data do not show at all are left alone.
  static Eigen::VectorXd solve(const Eigen::MatrixXd& information, const Eigen::VectorXd& gradient) {
    if (gradient.size() == 0) return gradient;
    return statistics::ScaledFactor(information, 1e-10).solve(gradient);
  }

  Part everything() const {
    Part all{std::vector<Eigen::Index>(static_cast<std::size_t>(parameters_)),
             std::vector<int>(static_cast<std::size_t>(initial_states_))};
    std::iota(all.parameters.begin(), all.parameters.end(), 0);
    std::iota(all.initial_states.begin(), all.initial_states.end(), 0);
    return all;
  }

  const Unknowns& unknowns() const { return unknowns_; }
  int all_parameters() const { return shape_.parameters(); }

 private:
  friend FitOfRuns;
  bool is_possible(const Point& point) const { return point.allFinite(); }
  SimulatedModel model_at(const Point& point) const { return SimulatedModel(parameters_at(point)); }
  bool linearise_run(const SimulatedModel& model, std::size_t r, const Eigen::VectorXd& initial,
                     ExtendedRun& linear) const {
    return linearise(runs_[r], model.brake, model.parameters, unknowns_, initial, {}, Gains::Kept, linear);
  }
  const Eigen::MatrixXd& normal_of_run(std::size_t r, ExtendedRun& linear) const {
    compute_normal(runs_[r], linear);
    return linear.normal;
  }
  double squares_of_run(const SimulatedModel& model, std::size_t r, const Eigen::VectorXd& initial) const {
    return sum_of_squares_of(runs_[r], model.brake, initial, now_.linear[r]);
  }
  const Eigen::MatrixXd& normal_by_unknowns(std::size_t r) const { return now_.normals[r]; }
  int column(int i) const { return i; }

  /// Free states that no parameter pays for differ from run to run by their prior: the likelihood is its
  /// average over it (Laplace), or else each of them could follow the noise of its run for nothing.
  double cost_of_drawn_states(const Eigen::MatrixXd& normal, const std::vector<int>& initial_states) const {
    if (drawn_.empty()) return 0.0;
    const auto block = normal.block(parameters_, parameters_, initial_states_, initial_states_);
    std::vector<int> others;
    double cost = 0.0;
    for (const int i : initial_states) {
      if (std::find(drawn_.begin(), drawn_.end(), i) == drawn_.end())
        others.push_back(i);
      else
        cost += 2.0 * std::log(prior_[static_cast<std::size_t>(i)]);
    }
    return cost + log_determinant(block(initial_states, initial_states)) -
           log_determinant(block(others, others));
  }
  static double log_determinant(const Eigen::MatrixXd& matrix) {
    return statistics::SymmetricFactor(matrix).log_determinant(1e-300);
  }

  ExtendedParameters model_;
  ExtendedBrake shape_;
  Unknowns unknowns_;
  std::vector<Eigen::VectorXd> starts_;
  std::vector<int> drawn_;  ///< those of the initial_states that the prior draws for each run
};

Eigen::MatrixXd covariance_of(const ExtendedFit& fit, const ExtendedParameters& model) {
  const Reduced joint = fit.joint();
  const int all = fit.all_parameters();
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(all, all);
  if (fit.parameters() == 0) return covariance;
  const statistics::ScaledFactor factor(joint.information);
  if (!(factor.smallest_pivot() > 1e-10))
    return Eigen::MatrixXd::Constant(all, all, std::numeric_limits<double>::quiet_NaN());
  const Eigen::MatrixXd inverse = factor.inverse();
  for (int i = 0; i < fit.parameters(); ++i)
    for (int j = 0; j < fit.parameters(); ++j)
      covariance(fit.unknowns().parameter(i), fit.unknowns().parameter(j)) =
          inverse(i, j) * fit.unknowns().slope(model, i) * fit.unknowns().slope(model, j);
  return covariance;
}

/// Of unknowns; also where the information is singular: what it does not tell has an infinite deviation.
Eigen::VectorXd deviations_of(const Eigen::MatrixXd& information) {
  const Eigen::VectorXd scale = statistics::deviations_of_diagonal(information);
  const statistics::Spectrum spectrum = statistics::spectrum_of(statistics::scaled_by(information, scale));
  Eigen::VectorXd deviations(information.rows());
  for (Eigen::Index i = 0; i < information.rows(); ++i) {
    double variance = 0.0;
    for (Eigen::Index j = 0; j < spectrum.values.size(); ++j) {
      const double share = spectrum.vectors(i, j) * spectrum.vectors(i, j);
      if (share > 1e-12) variance += share / std::max(spectrum.values[j], 1e-14);
    }
    deviations[i] =
        information(i, i) > 0.0 ? std::sqrt(variance) / scale[i] : std::numeric_limits<double>::infinity();
  }
  return deviations;
}

StepForecast nothing_foreseen() {
  constexpr double kNever = -std::numeric_limits<double>::infinity();
  return {kNever, kNever, {}, {}};
}

/// A step of this part of a fit that was just renewed, the rest staying.
StepForecast forecast_of(const ExtendedFit& fit, const ExtendedParameters& model, const Part& part) {
  const Reduced joint = fit.joint(part);
  const ExtendedFit::Step step = fit.step_of(part, joint);
  const Eigen::VectorXd& move = step.move;
  StepForecast result{fit.log_likelihood(part), 0.0, move, deviations_of(joint.information)};
  result.after_step = result.log_likelihood + 0.5 * step.decrease;
  for (std::size_t i = 0; i < part.parameters.size(); ++i) {
    const int unknown = static_cast<int>(part.parameters[i]);
    const auto at = static_cast<Eigen::Index>(i);
    const double slope = fit.unknowns().slope(model, unknown);
    if (fit.unknowns().is_logarithmic(unknown)) result.step[at] = limited(move[at]);
    result.step[at] *= slope;
    result.sd[at] *= std::abs(slope);
  }
  return result;
}

}  // namespace

}  // namespace identify

using namespace identify;

std::vector<FitRun> fit_runs(std::span<const Run> runs,
                             const std::optional<TorqueWhileOff>& torque_while_off) {
  std::vector<FitRun> prepared;
  for (const Run& run : runs) {
    CLAMPD_ASSERT(run.force_N.size() == run.size() && run.velocity_rad_s.size() == run.size());
    const std::vector<std::uint8_t> all(run.size(), 1);
    prepared.push_back({static_cast<double>(prepared.size()), run.time_s, run.torque_Nm, run.force_N,
                        run.velocity_rad_s, all, all});
  }
  if (!prepared.empty()) prepared.front().torque_while_off = torque_while_off;
  return prepared;
}

void move_by(const EffectDelays& delays, std::vector<FitRun>& runs) {
  for (FitRun& run : runs) {
    const auto size = static_cast<std::ptrdiff_t>(run.size());
    const auto move = [&](std::vector<double>& channel, int by) {
      const std::ptrdiff_t late = std::min<std::ptrdiff_t>(by, size - 1);
      std::rotate(channel.begin(), channel.begin() + late, channel.end());
      std::fill(channel.end() - late, channel.end(),
                late < size ? channel[static_cast<std::size_t>(size - late - 1)] : 0.0);
    };
    const auto lose = [&](std::vector<std::uint8_t>& use, int by) {
      const std::ptrdiff_t late = std::min<std::ptrdiff_t>(by, size);
      std::rotate(use.begin(), use.begin() + late, use.end());
      std::fill(use.end() - late, use.end(), std::uint8_t{0});
    };
    if (delays.force > 0) {
      move(run.force_N, delays.force);
      lose(run.use_force, delays.force);
    }
    if (delays.velocity > 0) {
      move(run.velocity_rad_s, delays.velocity);
      lose(run.use_velocity, delays.velocity);
    }
    if (delays.torque > 0) {
      move(run.torque_Nm, delays.torque);
      // The torque that acted at the end is not known; its readings are of no use.
      std::fill(run.use_force.end() - std::min<std::ptrdiff_t>(delays.torque, size), run.use_force.end(),
                std::uint8_t{0});
      std::fill(run.use_velocity.end() - std::min<std::ptrdiff_t>(delays.torque, size),
                run.use_velocity.end(), std::uint8_t{0});
    }
  }
}

void drop_unusable(const EffectDelays& delays, std::vector<FitRun>& runs) {
  for (FitRun& run : runs) {
    const auto first = [&](int count) {
      return std::min<std::ptrdiff_t>(count, static_cast<std::ptrdiff_t>(run.size()));
    };
    std::fill_n(run.use_force.begin(), first(delays.force), std::uint8_t{0});
    std::fill_n(run.use_velocity.begin(), first(delays.velocity), std::uint8_t{0});
    std::fill(run.use_force.end() - first(delays.torque), run.use_force.end(), std::uint8_t{0});
    std::fill(run.use_velocity.end() - first(delays.torque), run.use_velocity.end(), std::uint8_t{0});
  }
}

ExtendedEstimate fit_extended(std::span<const FitRun> runs, const ExtendedEstimate& start,
                              const ExtendedFitOptions& options) {
  ExtendedEstimate estimate = start;
  estimate.possible = estimate.settled = false;
  estimate.iterations = 0;
  estimate.log_likelihood = -std::numeric_limits<double>::infinity();
  if (!within_bounds(start.parameters)) return estimate;
  std::array<bool, kParameterCount> held = options.held;
  if (options.hold_parameters) held.fill(true);
  ExtendedFit fit(runs, start, held, options.threads, options.hold_parameters);
  MinimiserOf<ExtendedFit> minimise(fit, MinimiserOf<ExtendedFit>::Kinks::Accept);
  Eigen::VectorXd point = fit.start();
  Variances variances = variances_of(start.noise);
  if (options.estimate_noise)
    variances.torque = std::max(variances.torque, 4.0 * kSmallestTorque_Nm * kSmallestTorque_Nm);
  for (int round = 0; round < kMaxRounds; ++round) {
    if (!fit.use_innovations(point, variances)) break;
    const double likelihood = fit.log_likelihood();
    if (likelihood > estimate.log_likelihood) {
      const double gained = likelihood - estimate.log_likelihood;
      estimate.possible = true;
      estimate.parameters = fit.parameters_at(point);
      estimate.initial_states = fit.initial_at(point);
      estimate.noise = levels_of(variances);
      estimate.log_likelihood = likelihood;
      estimate.readings = fit.readings();
      estimate.covariance = covariance_of(fit, estimate.parameters);
      if (round > 1 && gained < 0.02 && estimate.settled) break;
    } else if (round > 2) {
      // Kinks of the filter can make gains and parameters answer each other for ever.
      estimate.settled = true;
      break;
    }
    if (estimate.iterations >= options.max_iterations) break;
    const bool may_be_hopeless = std::isfinite(options.least_log_likelihood);
    if (may_be_hopeless && round > 0 &&
        estimate.log_likelihood + kHopelessSteps * 0.5 * fit.expected_decrease() <
            options.least_log_likelihood)
      break;
    const int left = options.max_iterations - estimate.iterations;
    const double begun = fit.sum_of_squares();
    const Descent descent =
        minimise(fit, point, may_be_hopeless && round == 0 ? std::min(kHopelessIterations, left) : left);
    estimate.iterations += std::max(1, descent.iterations);
    if (!descent.possible) break;
    const bool moved = begun - fit.sum_of_squares() > minimiser::kToleranceEach * fit.NumParameters();
    double change = 0.0;
    if (options.estimate_noise) {
      const Variances found = fit.estimate_noise(variances, kNoiseIterations);
      change = change_between(variances, found, kNegligibleExtendedTorque);
      variances = found;
    }
    estimate.settled = descent.settled && change < kExtendedNoiseTolerance;
    if (estimate.settled && round > 0 && !moved && change < 0.1 * kExtendedNoiseTolerance) break;
  }
  return estimate;
}

ExtendedEstimate fit_base(std::span<const Run> runs, const BrakeParameters& start,
                          const ThreadBudget& threads) {
  EstimatorOptions options;
  options.start = start;
  options.threads = threads;
  const Estimate first = identify_prediction_error(runs, options);
  ExtendedEstimate warm;
  warm.parameters.base = start;
  if (first.parameters.theta.allFinite()) warm.parameters.base.theta = first.parameters.theta;
  const SensorNoise seen = noise_without_model(runs);
  warm.noise = {
      {std::isfinite(first.noise_force_N) ? first.noise_force_N : seen.force_N,
       std::isfinite(first.noise_velocity_rad_s) ? first.noise_velocity_rad_s : seen.velocity_rad_s},
      std::isfinite(first.noise_torque_Nm) ? std::max(first.noise_torque_Nm, 1e-3) : 0.01};
  for (std::size_t r = 0; r < runs.size(); ++r)
    warm.initial_states.emplace_back(
        first.initial_states.size() == runs.size() && first.initial_states[r].allFinite()
            ? Eigen::VectorXd(first.initial_states[r])
            : Eigen::VectorXd(initial_state_guess(runs[r], warm.parameters.base.theta)));
  ExtendedFitOptions fitting;
  fitting.threads = threads;
  return fit_extended(fit_runs(runs), warm, fitting);
}

ExtendedEstimate with_effect(const ExtendedEstimate& estimate, const EffectValues& effect) {
  ExtendedEstimate extended = estimate;
  extended.parameters.effects.push_back(effect);
  for (Eigen::VectorXd& initial : extended.initial_states) {
    const Eigen::Index known = initial.size();
    const int free = info_of(*effect.effect).free_states;
    initial.conservativeResize(known + free);
    initial.tail(free).setZero();
  }
  return extended;
}

ExtendedEstimate without_effect(const ExtendedEstimate& estimate, std::size_t index) {
  ExtendedEstimate reduced = estimate;
  CLAMPD_ASSERT(index < estimate.parameters.effects.size());
  Eigen::Index first = 2;
  for (std::size_t e = 0; e < index; ++e)
    first += info_of(*estimate.parameters.effects[e].effect).free_states;
  const int free = info_of(*estimate.parameters.effects[index].effect).free_states;
  for (Eigen::VectorXd& initial : reduced.initial_states) {
    const Eigen::Index after = initial.size() - first - free;
    const Eigen::VectorXd tail = initial.tail(after);
    initial.conservativeResize(first + after);
    initial.tail(after) = tail;
  }
  reduced.parameters.effects.erase(reduced.parameters.effects.begin() + static_cast<std::ptrdiff_t>(index));
  return reduced;
}

StepForecast forecast(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                      const ThreadBudget& threads) {
  if (!within_bounds(estimate.parameters)) return nothing_foreseen();
  ExtendedFit fit(runs, estimate, {}, threads);
  if (!fit.use_innovations(fit.start(), variances_of(estimate.noise))) return nothing_foreseen();
  return forecast_of(fit, estimate.parameters, fit.everything());
}

std::vector<StepForecast> forecast_each(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                        std::span<const EffectValues> effects, const ThreadBudget& threads) {
  std::vector<StepForecast> forecasts(effects.size(), nothing_foreseen());
  ExtendedEstimate extended = estimate;
  for (const EffectValues& effect : effects) extended = with_effect(extended, effect);
  if (!within_bounds(extended.parameters)) return forecasts;
  ExtendedFit fit(runs, extended, {}, threads);
  if (!fit.use_innovations(fit.start(), variances_of(estimate.noise))) return forecasts;
  const ExtendedBrake brake(extended.parameters);
  const auto present = static_cast<int>(estimate.parameters.effects.size());
  Part known;
  for (std::size_t i = 0; i < brake.places().size(); ++i)
    if (brake.places()[i].effect < present) known.parameters.push_back(static_cast<Eigen::Index>(i));
  int local = 2;
  for (const EffectValues& values : estimate.parameters.effects) local += info_of(*values.effect).free_states;
  known.initial_states.resize(static_cast<std::size_t>(local));
  std::iota(known.initial_states.begin(), known.initial_states.end(), 0);
  for (std::size_t e = 0; e < effects.size(); ++e) {
    Part part = known;
    for (std::size_t i = 0; i < brake.places().size(); ++i)
      if (brake.places()[i].effect == present + static_cast<int>(e))
        part.parameters.push_back(static_cast<Eigen::Index>(i));
    for (int i = 0; i < info_of(*effects[e].effect).free_states; ++i) part.initial_states.push_back(local++);
    forecasts[e] = forecast_of(fit, extended.parameters, part);
  }
  return forecasts;
}

Eigen::MatrixXd covariance_over_runs(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                     const ThreadBudget& threads) {
  constexpr std::size_t kFewestRuns = 5;
  constexpr double kLeastLeft = 0.05;  // of the information, without a run that tells nearly everything
  if (runs.size() < kFewestRuns || !estimate.covariance.allFinite()) return estimate.covariance;
  ExtendedFit fit(runs, estimate, {}, threads);
  if (fit.parameters() == 0 || !fit.use_innovations(fit.start(), variances_of(estimate.noise)))
    return estimate.covariance;
  const Eigen::MatrixXd information = fit.joint().information;
  const Eigen::VectorXd scale = statistics::deviations_of_diagonal(information);
  const statistics::CholeskyFactor factor(statistics::scaled_by(information, scale));
  if (!factor.is_positive()) return estimate.covariance;
  Eigen::MatrixXd scatter = Eigen::MatrixXd::Zero(information.rows(), information.cols());
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const Reduced run = fit.reduced(r);
    const Eigen::VectorXd score = factor.solve_lower(run.gradient.cwiseQuotient(scale));
    const Eigen::MatrixXd half = factor.solve_lower(statistics::scaled_by(run.information, scale));
    const Eigen::MatrixXd share = factor.solve_lower(half.transpose());
    // The fit has followed the run by its share of the information.
    const statistics::Spectrum parts = statistics::spectrum_of(share);
    const Eigen::ArrayXd left = (1.0 - parts.values.array()).max(kLeastLeft);
    const Eigen::VectorXd by_parts = parts.vectors.transpose() * score;
    const Eigen::VectorXd own = parts.vectors * (by_parts.array() / left.sqrt()).matrix();
    scatter += own * own.transpose();
  }
  const Eigen::MatrixXd half = factor.solve_upper(scatter);
  const Eigen::MatrixXd over_runs = factor.solve_upper(half.transpose());
  Eigen::VectorXd larger = Eigen::VectorXd::Ones(estimate.covariance.rows());
  for (int i = 0; i < fit.parameters(); ++i) {
    const int at = fit.unknowns().parameter(i);
    const double slope = fit.unknowns().slope(estimate.parameters, i) / scale[i];
    const double ratio = over_runs(i, i) * slope * slope / estimate.covariance(at, at);
    if (ratio > 1.0) larger[at] = std::sqrt(ratio);
  }
  return larger.asDiagonal() * estimate.covariance * larger.asDiagonal();
}

std::vector<FilteredRun> filter_runs(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                     const ThreadBudget& threads) {
  ExtendedFit fit(runs, estimate, {}, threads);
  const Variances variances = variances_of(estimate.noise);
  if (!fit.use_innovations(fit.start(), variances)) return {};
  const ExtendedBrake brake(estimate.parameters);
  std::vector<FilteredRun> views(runs.size());
  for_each_index(runs.size(), threads, [&](std::size_t r) {
    ExtendedRun& linear = fit.linear_runs()[r];
    const FitRun& run = runs[r];
    FilteredRun& view = views[r];
    std::vector<double> innovation;
    const std::size_t size = run.size();
    const auto n = static_cast<std::size_t>(linear.states);
    const int data = linear.columns() - 1;
    ExtendedBrake::State state(linear.states);
    double squares = 0.0;
    for (std::size_t k = 0; k < size; ++k) {
      const auto at = static_cast<Eigen::Index>(2 * k);
      const double force = linear.innovations(data, at);
      const double velocity = linear.innovations(data, at + 1);
      squares += force * force + velocity * velocity;
      view.force.push_back(run.use_force[k] ? force : std::numeric_limits<double>::quiet_NaN());
      view.velocity.push_back(run.use_velocity[k] ? velocity : std::numeric_limits<double>::quiet_NaN());
      for (std::size_t i = 0; i < n; ++i) state[static_cast<Eigen::Index>(i)] = linear.reference[k * n + i];
      view.predicted_force_N.push_back(run.force_N[k] - linear.residual[2 * k]);
      view.predicted_velocity_rad_s.push_back(run.velocity_rad_s[k] - linear.residual[2 * k + 1]);
      view.position_rad.push_back(state[0]);
      view.true_velocity_rad_s.push_back(state[1]);
    }
    view.log_likelihood =
        -0.5 * (squares + linear.log_determinant + linear.readings * std::log(2.0 * std::numbers::pi));
    recompute_gains(run, variances, linear, innovation);
    smooth(run, linear, innovation, &view.disturbance_Nm);
    for (double& value : view.disturbance_Nm) value *= variances.torque;
    // Free of the filter's corrections: the model alone, driven by the torque as the smoother has it.
    state = first_state(run, brake, estimate.initial_states[r]);
    for (std::size_t k = 0; k < size; ++k) {
      RowInput row = row_input(run, k);
      const bool bounded = ExtendedBrake::is_bounded(state);
      const Reading reading = bounded ? brake.read(state, row) : Reading{NAN, NAN};
      view.simulated_force_N.push_back(reading.force_N);
      view.simulated_velocity_rad_s.push_back(reading.velocity_rad_s);
      if (!bounded) continue;
      row.torque_Nm += view.disturbance_Nm[k];
      state = brake.advance(state, row);
    }
  });
  return views;
}

struct SignalScorer::Filtered {
  Filtered(std::span<const FitRun> given, const ExtendedEstimate& estimate, const ThreadBudget& threads)
      : runs(given), model(estimate.parameters), fit(given, estimate, {}, threads) {
    possible = fit.use_innovations(fit.start(), variances_of(estimate.noise));
    if (!possible) return;
    joint = fit.joint();
    factor = statistics::ScaledFactor(joint.information, 1e-10);
  }

  std::span<const FitRun> runs;
  const ExtendedParameters& model;
  ExtendedFit fit;
  bool possible = false;
  Reduced joint;
  statistics::ScaledFactor factor;  ///< of the parameters' information
};

SignalScorer::SignalScorer(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                           const ThreadBudget& threads)
    : filtered_(std::make_unique<const Filtered>(runs, estimate, threads)) {}

SignalScorer::~SignalScorer() = default;

SignalScores SignalScorer::score(const SignalColumns& signals, int blocks) const {
  const Eigen::Index columns = signals.rows.empty() ? 0 : signals.rows.front().cols();
  SignalScores scores{Eigen::VectorXd::Zero(columns), Eigen::MatrixXd::Zero(columns, columns),
                      Eigen::VectorXd::Zero(columns)};
  if (!filtered_->possible) return scores;
  const Eigen::Index width = blocks > 0 ? blocks : columns;
  const auto in_blocks = [&](const Eigen::MatrixXd& left, const Eigen::MatrixXd& right, double sign) {
    for (Eigen::Index first = 0; first + width <= columns && width > 0; first += width)
      scores.information.block(first, first, width, width) +=
          sign * left.middleCols(first, width).transpose() * right.middleCols(first, width);
  };
  const ExtendedFit& fit = filtered_->fit;
  const int p = fit.parameters();
  Eigen::MatrixXd with_parameters = Eigen::MatrixXd::Zero(p, columns);
  for (std::size_t r = 0; r < filtered_->runs.size(); ++r) {
    const ExtendedRun& linear = fit.linear_runs()[r];
    const Eigen::MatrixXd& normal = fit.normal(r);
    const Eigen::MatrixXd seen =
        filter_signals(filtered_->runs[r], linear, signals.kind, signals.rows[r], filtered_->model)
            .transpose();
    const int l = linear.initial_states;
    // Of parameters, initial_states and data with the signals; then the run's own initial state follows.
    const Eigen::MatrixXd products = linear.innovations * seen;
    const Eigen::MatrixXd local_products = products.middleRows(p, l);
    const Eigen::MatrixXd solved =
        statistics::SymmetricFactor(normal.block(p, p, l, l)).solve_columns(local_products);
    with_parameters += products.topRows(p) - normal.block(0, p, p, l) * solved;
    scores.alone += seen.colwise().squaredNorm().transpose();
    scores.score -= products.row(p + l).transpose() - solved.transpose() * normal.block(p, p + l, l, 1);
    in_blocks(seen, seen, 1.0);
    in_blocks(local_products, solved, -1.0);
  }
  const Eigen::VectorXd& scale = filtered_->factor.scale();
  const Eigen::MatrixXd whitened = scale.cwiseInverse().asDiagonal() * with_parameters;
  const Eigen::MatrixXd solved = filtered_->factor.scaled().solve_columns(whitened);
  scores.score += solved.transpose() * filtered_->joint.gradient.cwiseQuotient(scale);
  in_blocks(whitened, solved, -1.0);
  return scores;
}

}  // namespace clampd
