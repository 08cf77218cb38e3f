#include "clampd/identify/extended_identification.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "clampd/base/assert.hpp"
#include "clampd/base/nan.hpp"
#include "clampd/identify/extended_fit.hpp"
#include "clampd/identify/parameter_scores.hpp"
#include "clampd/identify/prediction_error.hpp"
#include "clampd/identify/spikes.hpp"
#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/conclusion.hpp"
#include "src/identify/starting_point.hpp"

namespace clampd {

namespace identify {

namespace {

using Role = EffectParameter::Role;

/// As in conclude(): of the nominal value.
constexpr double kUndetermined = 3.0;
constexpr std::size_t kFewestRunsForScatter = 8;

/// Information, each parameter scaled to one of its own, below which a direction is not determined.
constexpr double kSingularExtended = 1e-11;

/// Further than this from its neutral value, in standard deviations, an effect is surely there.
constexpr double kSurelyThere = 5.0;

/// For a first torque noise where there is no estimate of it.
constexpr double kLikelyTorqueNoise_Nm = 0.01;

/// Of the readings' noise, an offset small enough for the scores to be linear in it.
constexpr double kOffsetShare = 0.1;

constexpr int kSpikeRounds = 6;

std::string name_at(const ExtendedParameters& model, const ExtendedBrake::Place& place) {
  if (place.effect < 0) return std::string(kParameterTable[static_cast<std::size_t>(place.parameter)].name);
  return fmt::format("{}.{}", info_of(*model.effects[static_cast<std::size_t>(place.effect)].effect).name,
                     parameter_at(model, place).name);
}

bool is_bounded_by_neutral(const EffectParameter& parameter) {
  return parameter.role == Role::Strength &&
         (parameter.neutral == parameter.lower || parameter.neutral == parameter.upper);
}

/// Leaves out the spikes of a channel, of which the filter knows nothing; whether there were any.
bool mark_spikes(const std::vector<double>& innovations, std::vector<std::uint8_t>& use) {
  const std::vector<std::size_t> spikes = spikes_in(innovations, spike_limit(innovations));
  for (const std::size_t row : spikes) use[row] = 0;
  return !spikes.empty();
}

/// The extended model fitted to runs.
class Extension {
 public:
  Extension(std::span<const Run> runs, const ExtendedParameters& model, const EstimatorOptions& options)
      : model_(model),
        runs_(fit_runs(runs)),
        order_(model.effects.size()),
        absent_(model.effects.size(), false) {
    for (std::size_t e = 0; e < order_.size(); ++e) order_[e] = e;
    model_.base.fixed = options.start.fixed;
    for (const EffectValues& effect : model_.effects) {
      CLAMPD_ASSERT(effect.values.size() == info_of(*effect.effect).parameters.size());
      has_spikes_ = has_spikes_ || info_of(*effect.effect).removes_readings;
    }
    move_by(delays_of(model_), runs_);
    settings_.max_iterations = options.max_iterations;
    settings_.held = options.held;
    settings_.estimate_noise = !options.noise_torque_Nm;
  }

  /// From base parameters with initial states and noise; a likelier fit than the one so far is kept.
  void fit_from(const ParameterVector& theta, std::vector<Eigen::VectorXd> initial,
                const NoiseLevels& noise) {
    ExtendedEstimate start;
    start.parameters.base = {theta, model_.base.fixed};
    start.initial_states = std::move(initial);
    start.noise = noise;
    for (const EffectValues& effect : model_.effects) start = with_effect(start, effect);
    ExtendedEstimate found = fit(start);
    if (found.possible && (!estimate_.possible || found.log_likelihood > estimate_.log_likelihood))
      estimate_ = std::move(found);
  }

  /// Readings that the model calls spikes do not count any more.
  void leave_out_spikes() {
    for (int round = 0; has_spikes_ && estimate_.possible && round < kSpikeRounds; ++round) {
      const std::vector<FilteredRun> filtered = filter_runs(runs_, estimate_);
      bool any = false;
      for (std::size_t r = 0; r < filtered.size(); ++r) {
        any |= mark_spikes(filtered[r].force, runs_[r].use_force);
        any |= mark_spikes(filtered[r].velocity, runs_[r].use_velocity);
      }
      if (!any) return;
      estimate_ = fit(estimate_);
    }
  }

  /// A search does not end at a bound, only near it: the model without the effect is what it looked for.
  void find_absent_effects() {
    for (std::size_t e = 0; e < order_.size() && estimate_.possible; ++e) {
      const auto at = static_cast<std::size_t>(std::find(order_.begin(), order_.end(), e) - order_.begin());
      if (!may_be_absent(at)) continue;
      ExtendedEstimate without = fit(without_effect(estimate_, at));
      if (!without.possible || without.log_likelihood < estimate_.log_likelihood) continue;
      EffectValues neutral = model_.effects[e];
      const EffectInfo& info = info_of(*neutral.effect);
      for (std::size_t i = 0; i < info.parameters.size(); ++i)
        if (info.parameters[i].role == Role::Strength) neutral.values[i] = info.parameters[i].neutral;
      estimate_ = with_effect(without, neutral);
      order_.erase(order_.begin() + static_cast<std::ptrdiff_t>(at));
      order_.push_back(e);
      absent_[e] = true;
    }
  }

  const ExtendedEstimate& estimate() const { return estimate_; }
  const std::vector<FitRun>& runs() const { return runs_; }
  int iterations() const { return iterations_; }

  /// Where effect e of the model is in the estimate.
  std::size_t place_of(std::size_t e) const {
    return static_cast<std::size_t>(std::find(order_.begin(), order_.end(), e) - order_.begin());
  }
  bool is_absent(std::size_t e) const { return absent_[e]; }

 private:
  ExtendedEstimate fit(const ExtendedEstimate& start) {
    ExtendedEstimate found = fit_extended(runs_, start, settings_);
    iterations_ += found.iterations;
    return found;
  }

  bool may_be_absent(std::size_t at) const {
    const EffectValues& values = estimate_.parameters.effects[at];
    const EffectInfo& info = info_of(*values.effect);
    if (!delays_of(values).none()) return false;
    const StepForecast step = forecast(runs_, estimate_);
    const ExtendedBrake shape(estimate_.parameters);
    bool bounded = false;
    for (std::size_t p = 0; p < shape.places().size(); ++p) {
      const ExtendedBrake::Place& place = shape.places()[p];
      if (place.effect != static_cast<int>(at)) continue;
      const EffectParameter& parameter = info.parameters[static_cast<std::size_t>(place.parameter)];
      if (parameter.role != Role::Strength) continue;
      if (!is_bounded_by_neutral(parameter)) return false;
      bounded = true;
      const double distance =
          std::abs(values.values[static_cast<std::size_t>(place.parameter)] - parameter.neutral);
      if (step.sd.size() > 0 && distance > kSurelyThere * step.sd[static_cast<Eigen::Index>(p)]) return false;
    }
    return bounded;
  }

  ExtendedParameters model_;
  std::vector<FitRun> runs_;
  ExtendedFitOptions settings_;
  ExtendedEstimate estimate_;
  std::vector<std::size_t> order_;  ///< effect of the model at each place of the estimate
  std::vector<bool> absent_;
  bool has_spikes_ = false;
  int iterations_ = 0;
};

/// What the runs tell about the parameters at an estimate, those set aside that they do not determine.
class Precision {
 public:
  Precision(const Extension& extension, const Held& held)
      : extension_(extension),
        model_(extension.estimate().parameters),
        shape_(model_),
        scores_(score_parameters(extension.runs(), extension.estimate())) {
    if (!scores_.possible) return;
    for (int p = 0; p < shape_.parameters(); ++p) {
      const ExtendedBrake::Place& place = place_of(p);
      if (place.effect >= 0 || !held[static_cast<std::size_t>(place.parameter)]) free_.push_back(p);
    }
    while (!free_.empty() && invert()) {
      const std::optional<std::size_t> vague = undetermined();
      if (!vague) break;
      set_aside(*vague);
    }
    find_offset_sensitivity();
    find_scatter();
  }

  bool possible() const { return scores_.possible && !free_.empty(); }
  /// Base parameters and strengths among those set aside, by name.
  const std::string& unknown() const { return unknown_; }
  bool is_set_aside(int p) const {
    return std::find(set_aside_.begin(), set_aside_.end(), p) != set_aside_.end();
  }
  bool runs_differ() const { return runs_differ_; }
  double runs_agree_p() const { return runs_agree_p_; }

  /// Of parameters p and q of ExtendedBrake, SI; 0 where one is held.
  double covariance(int p, int q) const { return entry(runs_differ_ ? scatter_ : covariance_, p, q); }
  double scatter(int p, int q) const { return scatter_.size() == 0 ? kNaN : entry(scatter_, p, q); }
  double offset_sensitivity(int p, int channel) const {
    const auto found = std::find(free_.begin(), free_.end(), p);
    return found == free_.end() ? 0.0 : offsets_(found - free_.begin(), channel);
  }

 private:
  const ExtendedBrake::Place& place_of(int p) const { return shape_.places()[static_cast<std::size_t>(p)]; }

  double entry(const Eigen::MatrixXd& matrix, int p, int q) const {
    const auto row = std::find(free_.begin(), free_.end(), p);
    const auto column = std::find(free_.begin(), free_.end(), q);
    if (row == free_.end() || column == free_.end()) return is_set_aside(p) || is_set_aside(q) ? kNaN : 0.0;
    return matrix(row - free_.begin(), column - free_.begin());
  }

  Eigen::VectorXd of_free(const Eigen::VectorXd& all) const {
    Eigen::VectorXd some(static_cast<Eigen::Index>(free_.size()));
    for (std::size_t i = 0; i < free_.size(); ++i) some[static_cast<Eigen::Index>(i)] = all[free_[i]];
    return some;
  }

  void set_aside(std::size_t which) {
    const int p = free_[which];
    const ExtendedBrake::Place& place = place_of(p);
    // The shape of an effect that does not show is nothing to miss.
    if (place.effect < 0 || parameter_at(model_, place).role == Role::Strength)
      unknown_ += (unknown_.empty() ? "" : ", ") + name_at(model_, place);
    set_aside_.push_back(p);
    free_.erase(free_.begin() + static_cast<std::ptrdiff_t>(which));
  }

  /// The covariance of the free parameters. Those in directions without information are set aside.
  bool invert() {
    while (!free_.empty()) {
      const auto size = static_cast<Eigen::Index>(free_.size());
      Eigen::MatrixXd information(size, size);
      for (Eigen::Index i = 0; i < size; ++i)
        for (Eigen::Index j = 0; j < size; ++j)
          information(i, j) =
              scores_.information(free_[static_cast<std::size_t>(i)], free_[static_cast<std::size_t>(j)]);
      Eigen::Index worst = 0;
      if (information.diagonal().minCoeff(&worst) > 0.0) {
        const Eigen::VectorXd scale = information.diagonal().cwiseSqrt();
        const statistics::Spectrum spectrum =
            statistics::spectrum_of(statistics::scaled_by(information, scale));
        if (spectrum.values[0] > kSingularExtended) {
          const Eigen::MatrixXd directions = scale.cwiseInverse().asDiagonal() * spectrum.vectors;
          covariance_ = directions * spectrum.values.cwiseInverse().asDiagonal() * directions.transpose();
          return true;
        }
        spectrum.vectors.col(0).cwiseAbs().maxCoeff(&worst);
      }
      set_aside(static_cast<std::size_t>(worst));
    }
    return false;
  }

  /// The vaguest of the parameters at a bound, or known no better than sense demands.
  std::optional<std::size_t> undetermined() const {
    std::optional<std::size_t> vaguest;
    double most = 1.0;
    for (std::size_t i = 0; i < free_.size(); ++i) {
      const ExtendedBrake::Place& place = place_of(free_[i]);
      const double value = value_at(model_, place);
      const auto at = static_cast<Eigen::Index>(i);
      const double sd = std::sqrt(covariance_(at, at));
      double lower = 0.0, upper = 0.0, vagueness = 0.0;
      double margin = 1e-3 * std::abs(value);
      if (place.effect < 0) {
        const ParameterInfo& info = kParameterTable[static_cast<std::size_t>(place.parameter)];
        lower = info.lower;
        upper = info.upper;
        vagueness = sd / (kUndetermined * std::abs(info.nominal));
      } else {
        const EffectParameter& info = parameter_at(model_, place);
        constexpr double kInfinity = std::numeric_limits<double>::infinity();
        // A strength at a bound is as known as any: a whole sample late, a lag that is not there.
        const bool strength = info.role == Role::Strength;
        lower = strength ? -kInfinity : info.lower;
        upper = strength ? kInfinity : info.upper;
        margin = std::max(margin, 1e-6 * (info.upper - info.lower));
        vagueness = sd / (info.upper - info.lower);
      }
      if (value < lower + margin || value > upper - margin) return i;
      if (vagueness > most) {
        most = vagueness;
        vaguest = i;
      }
    }
    return vaguest;
  }

  /// How the estimate follows an offset common to all readings of a channel.
  void find_offset_sensitivity() {
    const NoiseLevels& noise = extension_.estimate().noise;
    offsets_.setZero(static_cast<Eigen::Index>(free_.size()), 2);
    for (const int channel : {0, 1}) {
      const double offset =
          kOffsetShare * (channel == 0 ? noise.sensors.force_N : noise.sensors.velocity_rad_s);
      Eigen::VectorXd change = Eigen::VectorXd::Zero(offsets_.rows());
      for (const double sign : {1.0, -1.0}) {
        std::vector<FitRun> shifted = extension_.runs();
        for (FitRun& run : shifted)
          for (double& reading : channel == 0 ? run.force_N : run.velocity_rad_s) reading += sign * offset;
        const ParameterScores scores = score_parameters(shifted, extension_.estimate());
        change += sign / (2.0 * offset) * of_free(scores.gradient);
      }
      offsets_.col(channel) = covariance_ * change;
    }
  }

  /// Covariance by the scatter of the runs' own scores, and whether it exceeds what the noise explains. A few
  /// runs tell the second, but not the first.
  void find_scatter() {
    const std::vector<FitRun>& runs = extension_.runs();
    const std::size_t size = free_.size();
    if (runs.size() < 2 || size == 0) return;
    Eigen::MatrixXd own(covariance_.rows(), static_cast<Eigen::Index>(runs.size()));
    for (std::size_t r = 0; r < runs.size(); ++r)
      own.col(static_cast<Eigen::Index>(r)) = of_free(scores_.of_runs[r].gradient);
    // At a bound they do not add up to zero.
    own.colwise() -= own.rowwise().mean().eval();
    const Eigen::MatrixXd squares = own * own.transpose();
    const auto count = static_cast<double>(runs.size());
    const double statistic = count * (covariance_ * squares).trace();
    const double degrees = (count - 1.0) * static_cast<double>(size);
    runs_agree_p_ = statistics::chi_squared_p_value(statistic, degrees);
    if (runs.size() < kFewestRunsForScatter || runs.size() <= size) return;
    scatter_ = count / (count - 1.0) * covariance_ * squares * covariance_;
    runs_differ_ = runs_agree_p_ < kRunsDiffer;
  }

  const Extension& extension_;
  const ExtendedParameters& model_;
  ExtendedBrake shape_;
  ParameterScores scores_;
  std::vector<int> free_;  ///< of ExtendedBrake's parameters
  std::vector<int> set_aside_;
  std::string unknown_;
  Eigen::MatrixXd covariance_, scatter_, offsets_;  ///< of the free ones
  bool runs_differ_ = false;
  double runs_agree_p_ = 1.0;
};

/// One-step prediction errors.
void fill_residuals(const Extension& extension, Estimate& estimate) {
  const std::vector<FilteredRun> filtered = filter_runs(extension.runs(), extension.estimate());
  Eigen::Vector2d all = Eigen::Vector2d::Zero();
  Eigen::Vector2d all_count = Eigen::Vector2d::Zero();
  for (std::size_t r = 0; r < filtered.size(); ++r) {
    const FitRun& run = extension.runs()[r];
    Eigen::Vector2d squares = Eigen::Vector2d::Zero();
    Eigen::Vector2d count = Eigen::Vector2d::Zero();
    for (std::size_t k = 0; k < run.size(); ++k) {
      const double force_N = run.force_N[k] - filtered[r].predicted_force_N[k];
      const double velocity_rad_s = run.velocity_rad_s[k] - filtered[r].predicted_velocity_rad_s[k];
      if (run.use_force[k] != 0) squares[0] += force_N * force_N, count[0] += 1.0;
      if (run.use_velocity[k] != 0) squares[1] += velocity_rad_s * velocity_rad_s, count[1] += 1.0;
    }
    const Eigen::Vector2d of_run = squares.cwiseQuotient(count).cwiseSqrt();
    estimate.run_force_rms_N.push_back(of_run[0]);
    estimate.run_velocity_rms_rad_s.push_back(of_run[1]);
    all += squares;
    all_count += count;
  }
  const Eigen::Vector2d rms = all.cwiseQuotient(all_count).cwiseSqrt();
  estimate.force_rms_N = rms[0];
  estimate.velocity_rms_rad_s = rms[1];
}

void fill_base(const Precision& precision, const Held& held, Estimate& estimate) {
  const ParameterVector nominal = nominal_parameters();
  const bool whole = precision.unknown().empty();
  for (int i = 0; i < kTheta; ++i) {
    if (precision.is_set_aside(i)) estimate.parameters.theta[i] = kNaN;
    if (!whole) continue;
    for (int j = 0; j < kTheta; ++j) {
      const double scale = nominal[i] * nominal[j];
      estimate.covariance_normalised(i, j) = precision.covariance(i, j) / scale;
      estimate.covariance_over_runs(i, j) = precision.scatter(i, j) / scale;
    }
    for (const int channel : {0, 1})
      estimate.offset_sensitivity(i, channel) =
          held[static_cast<std::size_t>(i)] ? 0.0 : precision.offset_sensitivity(i, channel) / nominal[i];
  }
}

void fill_effects(const Extension& extension, const Precision& precision, Estimate& estimate) {
  const ExtendedParameters& model = extension.estimate().parameters;
  const ExtendedBrake shape(model);
  std::vector<std::optional<int>> numbers;  // of ExtendedBrake's parameters, for theta and each entry
  for (int i = 0; i < kTheta; ++i) numbers.emplace_back(i);
  for (std::size_t e = 0; e < model.effects.size(); ++e) {
    const std::size_t at = extension.place_of(e);
    const EffectInfo& info = info_of(*model.effects[at].effect);
    for (std::size_t i = 0; i < info.parameters.size(); ++i) {
      EffectEstimate entry{std::string(info.name), std::string(info.parameters[i].name),
                           std::string(info.parameters[i].unit), model.effects[at].values[i], kNaN};
      numbers.emplace_back();
      for (int p = 0; p < shape.parameters(); ++p) {
        const ExtendedBrake::Place& place = shape.places()[static_cast<std::size_t>(p)];
        if (place.effect != static_cast<int>(at) || place.parameter != static_cast<int>(i)) continue;
        numbers.back() = p;
        if (precision.is_set_aside(p)) {
          entry.value = kNaN;
        } else {
          entry.sd = std::sqrt(precision.covariance(p, p));
          entry.offset_sensitivity = {precision.offset_sensitivity(p, 0), precision.offset_sensitivity(p, 1)};
        }
      }
      estimate.effects.push_back(std::move(entry));
    }
  }
  if (!precision.unknown().empty()) return;
  const auto size = static_cast<Eigen::Index>(numbers.size());
  const ParameterVector nominal = nominal_parameters();
  estimate.covariance_with_effects.setZero(size, size);
  for (Eigen::Index i = 0; i < size; ++i)
    for (Eigen::Index j = 0; j < size; ++j) {
      const auto row = numbers[static_cast<std::size_t>(i)], column = numbers[static_cast<std::size_t>(j)];
      if (!row || !column) continue;
      estimate.covariance_with_effects(i, j) =
          precision.covariance(*row, *column) /
          ((i < kTheta ? nominal[i] : 1.0) * (j < kTheta ? nominal[j] : 1.0));
    }
}

Result<void> check_extended_options(const EstimatorOptions& options) {
  if (options.loss != Loss::Squared) {
    std::string names;
    for (const Effect* effect : effects())
      if (info_of(*effect).removes_readings) names += fmt::format("{}{}", names.empty() ? "" : " or ", info_of(*effect).name);
    return failure(fmt::format("a robust loss is for the base model; let a diagnosis put the effect {} into the model", names));
  }
  const int known = options.noise_force_N.has_value() + options.noise_velocity_rad_s.has_value() +
                    options.noise_torque_Nm.has_value();
  if (known != 0 && known != 3)
    return failure("with an extended model, give the noise of force, velocity and torque, or none of them");
  return {};
}

}  // namespace

}  // namespace identify

Estimate identify_extended(std::span<const Run> runs, const ExtendedParameters& model,
                           const EstimatorOptions& options) {
  using namespace identify;
  const Stopwatch stopwatch;
  Estimate estimate = empty_estimate(options);
  estimate.method = Method::PredictionError;
  const Result<void> valid =
      check_extended_options(options).and_then([&] { return check_input(runs, options); });
  if (!valid) {
    estimate.message = valid.error().message;
    return estimate;
  }
  const Estimate base = identify_prediction_error(runs, options);
  const SensorNoise seen = noise_without_model(runs);
  const auto or_else = [](double value, double otherwise) {
    return std::isfinite(value) ? value : otherwise;
  };
  const NoiseLevels noise{
      {options.noise_force_N.value_or(or_else(base.noise_force_N, seen.force_N)),
       options.noise_velocity_rad_s.value_or(or_else(base.noise_velocity_rad_s, seen.velocity_rad_s))},
      options.noise_torque_Nm.value_or(or_else(base.noise_torque_Nm, kLikelyTorqueNoise_Nm))};
  const auto guesses = [&](const ParameterVector& theta) {
    std::vector<Eigen::VectorXd> initial;
    for (const Run& run : runs) initial.emplace_back(initial_state_guess(run, theta));
    return initial;
  };

  Extension extension(runs, model, options);
  if (base.parameters.theta.allFinite() && base.initial_states.size() == runs.size())
    extension.fit_from(base.parameters.theta, {base.initial_states.begin(), base.initial_states.end()},
                       noise);
  ParameterVector own = model.base.theta;
  for (int i = 0; i < kTheta; ++i)
    if (options.held[static_cast<std::size_t>(i)]) own[i] = options.start.theta[i];
  extension.fit_from(own, guesses(own), noise);
  extension.leave_out_spikes();
  extension.find_absent_effects();

  const ExtendedEstimate& found = extension.estimate();
  estimate.iterations = base.iterations + extension.iterations();
  const auto end = [&](Termination termination, std::string message) {
    estimate.termination = termination;
    estimate.message = std::move(message);
    estimate.wall_s = stopwatch.seconds();
    withdraw_unexplained(runs, estimate);
    return estimate;
  };
  if (!found.possible)
    return end(Termination::NumericalFailure,
               "the Kalman filter cannot follow the runs from any start: it diverges under their torque");
  estimate.parameters.theta = found.parameters.base.theta;
  for (const Eigen::VectorXd& initial : found.initial_states)
    estimate.initial_states.push_back(initial.head<2>());
  estimate.noise_force_N = found.noise.sensors.force_N;
  estimate.noise_velocity_rad_s = found.noise.sensors.velocity_rad_s;
  estimate.noise_torque_Nm = found.noise.torque_Nm;
  estimate.log_likelihood = found.log_likelihood;
  fill_residuals(extension, estimate);
  const Precision precision(extension, options.held);
  if (!precision.possible())
    return end(Termination::NumericalFailure, "the fit says nothing about any parameter");
  estimate.runs_differ = precision.runs_differ();
  estimate.runs_agree_p = precision.runs_agree_p();
  if (estimate.runs_differ)
    estimate.degrees_of_freedom.setConstant(static_cast<double>(extension.runs().size() - 1));
  fill_base(precision, options.held, estimate);
  fill_effects(extension, precision, estimate);
  if (!precision.unknown().empty())
    return end(
        Termination::NotIdentifiable,
        fmt::format("not identifiable from these data: {}; excite the brake more, or hold what is known",
                    precision.unknown()));
  if (!found.settled)
    return end(Termination::IterationLimit,
               fmt::format("still improving after {} iterations from each start", options.max_iterations));
  std::string absent;
  for (std::size_t e = 0; e < model.effects.size(); ++e)
    if (extension.is_absent(e))
      absent += fmt::format("; {} does not show", info_of(*model.effects[e].effect).name);
  return end(Termination::Converged, "the cost no longer changes" + absent);
}

}  // namespace clampd
