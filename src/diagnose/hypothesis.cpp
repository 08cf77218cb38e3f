#include "src/diagnose/hypothesis.hpp"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <numbers>

#include "clampd/statistics/symmetric.hpp"
#include "src/diagnose/evidence.hpp"
#include "src/diagnose/look.hpp"

namespace clampd::diagnosing {

namespace {

using Role = EffectParameter::Role;

/// A start that promises less than this share of the best one is not worth a fit.
constexpr double kWorthAFit = 0.3;
/// A fit that brings less than this share of what was promised got stuck.
constexpr double kStuck = 0.85;
/// From here on (N m) the torque noise of a hypothesis is so large that it may have swallowed the effect.
constexpr double kSuspiciousTorque_Nm = 0.02;
constexpr double kModestTorque_Nm = 0.008;
constexpr double kHelps_nats = 1.0;
/// A fit that a step would improve by so much has not come to its end.
constexpr double kNotEnded_nats = 3.0;
/// A hypothesis that a step by itself would improve by so much got stuck, and a search from there may too.
constexpr double kStuck_nats = 30.0;
/// Closer to a bound of what is sensible than by this factor no brake is.
constexpr double kNearBound = 5.0;
/// A rough fit from elsewhere that is so much worse, per reading, will not come back.
constexpr double kHopeless_nats = 0.1;
/// Beside a better one a fit that ends so far behind it counts for nothing.
constexpr double kBehind_nats = 20.0;
/// No drive's torque is as noisy as this.
constexpr double kImpossibleTorque_Nm = 0.05;
constexpr std::size_t kMaxFits = 4;
/// The same of further choices, one after the other, that bring nothing more.
constexpr int kMaxMisses = 3;
/// Enough to see whether a candidate is among the best; those are then fitted to the end.
constexpr int kRoughIterations = 14;
/// A model that lacks an effect is near enough to its end where a step promises this share of what the effect
/// is worth.
constexpr double kNearEnough = 0.03;

/// A second period beside one that promises this share of what the first has brought may be the true one.
constexpr double kStandsOut = 0.1;
/// What readings would add that a model with these delays cannot use, if it missed them by its noise as it
/// does the others: that it cannot speaks neither for it nor against it.
double likelihood_of_unusable(const EffectDelays& delays, const Hypothesis& hypothesis) {
  const auto each = [](double deviation) {
    return -0.5 * (1.0 + std::log(2.0 * std::numbers::pi * deviation * deviation));
  };
  const SensorNoise& noise = hypothesis.estimate.noise.sensors;
  double sum = 0.0;
  for (const FitRun& run : hypothesis.runs) {
    const auto rows = [&](int late) {
      return std::min(static_cast<double>(late), static_cast<double>(run.size()));
    };
    sum += rows(delays.force + delays.torque) * each(noise.force_N) +
           rows(delays.velocity + delays.torque) * each(noise.velocity_rad_s);
  }
  return sum;
}

/// Where the seven parameters begin.
enum class Brake { Fitted, Nominal };

/// Moves parameters by this share of a step, within their bounds and no further than by a factor.
void move_along(const Eigen::VectorXd& step, double share, ExtendedParameters& model) {
  constexpr double kFurthest = 2.0;
  const ExtendedBrake brake(model);
  for (Eigen::Index i = 0; i < step.size(); ++i) {
    const ExtendedBrake::Place& place = brake.places()[static_cast<std::size_t>(i)];
    double& value = value_at(model, place);
    const double moved = value + share * step[i];
    if (place.effect < 0) {
      const ParameterInfo& info = kParameterTable[static_cast<std::size_t>(place.parameter)];
      const bool is_positive = info.lower > 0.0;
      value = is_positive ? std::clamp(moved, value / kFurthest, value * kFurthest) : moved;
      value = std::clamp(value, info.lower, info.upper);
    } else {
      const EffectParameter& info = parameter_at(model, place);
      value = info.logarithmic ? std::clamp(moved, value / kFurthest, value * kFurthest) : moved;
      value = std::clamp(value, info.lower, info.upper);
    }
  }
}

/// The other parameters follow an effect that a step puts beside them, as far as that helps.
void follow(const Start& start, Hypothesis& extended) {
  constexpr double kLeast = 0.2;
  const auto likelihood = [&] {
    return forecast(extended.runs, extended.estimate, extended.threads).log_likelihood;
  };
  const ExtendedParameters before = extended.estimate.parameters;
  const double alone = likelihood();
  for (double share = 1.0; share > kLeast; share *= 0.5) {
    ExtendedParameters moved = before;
    move_along(start.step, share, moved);
    std::swap(extended.estimate.parameters, moved);
    if (likelihood() > alone) return;
    std::swap(extended.estimate.parameters, moved);
  }
}

/// `least`: see refit().
Hypothesis fitted_from(const Start& start, const Hypothesis& hypothesis, double torque_noise_Nm,
                       int max_iterations, Brake brake = Brake::Fitted,
                       double least = ExtendedFitOptions{}.least_log_likelihood) {
  Hypothesis extended = hypothesis;
  extended.estimate = with_effect(hypothesis.estimate, start.values);
  const EffectDelays delays = delays_of(start.values);
  move_by(delays, extended.runs);
  if (start.step.size() > 0) follow(start, extended);
  extended.estimate.noise.torque_Nm = torque_noise_Nm;
  if (brake == Brake::Nominal) extended.estimate.parameters.base.theta = nominal_parameters();
  refit(extended, max_iterations, least - likelihood_of_unusable(delays, extended));
  extended.unused_log_likelihood += likelihood_of_unusable(delays, extended);
  extended.degrees += degrees_of(*start.values.effect, extended.runs.size());
  return extended;
}

/// Whether a misfit has pushed one of the seven parameters towards the end of what is sensible.
bool is_brake_impossible(const Hypothesis& hypothesis) {
  const ParameterVector& theta = hypothesis.estimate.parameters.base.theta;
  for (std::size_t i = k2; i < kParameterCount; ++i) {
    const ParameterInfo& info = kParameterTable[i];
    const double value = theta[static_cast<Eigen::Index>(i)];
    if (value < kNearBound * info.lower || value > info.upper / kNearBound) return true;
  }
  return false;
}

bool is_impossible(const Hypothesis& hypothesis) {
  return is_torque_impossible(hypothesis) || is_brake_impossible(hypothesis);
}

void keep_if_better(Hypothesis&& other, Hypothesis& kept) {
  if (!other.possible()) return;
  if (!kept.possible() || other.log_likelihood() > kept.log_likelihood()) kept = std::move(other);
}

/// What a step of all its parameters together would still bring (nats).
double promise_of(const Hypothesis& hypothesis) {
  const StepForecast step = forecast(hypothesis.runs, hypothesis.estimate, hypothesis.threads);
  return step.after_step - step.log_likelihood;
}

/// With this effect's choices of these roles made otherwise, one at a time; those far behind are not fitted
/// to the end.
void add_otherwise_chosen(const Hypothesis& hypothesis, std::size_t effect, std::initializer_list<Role> roles,
                          std::vector<Hypothesis>& list) {
  const EffectValues& values = hypothesis.estimate.parameters.effects[effect];
  const EffectInfo& info = info_of(*values.effect);
  if (!delays_of(values).none() || info.removes_readings) return;
  for (std::size_t i = 0; i < info.parameters.size(); ++i) {
    if (std::find(roles.begin(), roles.end(), info.parameters[i].role) == roles.end()) continue;
    for (const double choice : info.parameters[i].starts) {
      Hypothesis other = hypothesis;
      EffectValues& chosen = other.estimate.parameters.effects[effect];
      chosen.values = chosen_otherwise(*values.effect, values.values, i, choice);
      if (choice == values.values[i] || !delays_of(chosen).none()) continue;
      refit(other, kRoughIterations, hypothesis.log_likelihood() - kBehind_nats);
      if (other.possible()) list.push_back(std::move(other));
    }
  }
}

/// The hypothesis without one of its effects, to be fitted.
Hypothesis taken_out(const Hypothesis& hypothesis, std::size_t effect, std::span<const Run> recorded) {
  Hypothesis reduced;
  reduced.threads = hypothesis.threads;
  reduced.estimate = without_effect(hypothesis.estimate, effect);
  const EffectValues& removed = hypothesis.estimate.parameters.effects[effect];
  reduced.runs = hypothesis.runs;
  reduced.unused_log_likelihood = hypothesis.unused_log_likelihood;
  reduced.degrees = hypothesis.degrees - degrees_of(*removed.effect, recorded.size());
  const EffectDelays delays = delays_of(removed);
  if (!delays.none() || info_of(*removed.effect).removes_readings) {
    // The readings as recorded, and then as the effects that are left see them.
    reduced.runs = fit_runs(recorded, hypothesis.runs.front().torque_while_off);
    reduced.unused_log_likelihood = 0.0;
    for (const EffectValues& left : reduced.estimate.parameters.effects) {
      move_by(delays_of(left), reduced.runs);
    }
  }
  reduced.estimate.settled = false;
  reduced.estimate.log_likelihood = -std::numeric_limits<double>::infinity();
  return reduced;
}

}  // namespace

double known_strength(const Hypothesis& hypothesis, std::size_t effect) {
  const ExtendedParameters& model = hypothesis.estimate.parameters;
  const ExtendedBrake brake(model);
  std::vector<Eigen::Index> places;
  std::vector<double> distances;
  for (std::size_t i = 0; i < brake.places().size(); ++i) {
    const ExtendedBrake::Place& place = brake.places()[i];
    if (place.effect != static_cast<int>(effect)) continue;
    const EffectParameter& parameter = parameter_at(model, place);
    if (parameter.role != EffectParameter::Role::Strength) continue;
    places.push_back(static_cast<Eigen::Index>(i));
    distances.push_back(value_at(model, place) - parameter.neutral);
  }
  const Eigen::MatrixXd& covariance = hypothesis.estimate.covariance;
  if (places.empty() || covariance.rows() <= places.back()) return std::numeric_limits<double>::infinity();
  const Eigen::MatrixXd known = covariance(places, places);
  const Eigen::VectorXd distance =
      Eigen::Map<const Eigen::VectorXd>(distances.data(), static_cast<Eigen::Index>(distances.size()));
  const double nats = 0.5 * distance.dot(statistics::SymmetricFactor(known).solve(distance));
  return std::isfinite(nats) ? nats : std::numeric_limits<double>::infinity();
}

void weigh(Candidate& candidate, const Hypothesis& hypothesis) {
  candidate.gain = candidate.fitted.possible()
                       ? std::max(0.0, candidate.fitted.log_likelihood() - hypothesis.log_likelihood())
                       : 0.0;
  candidate.significance_nats = significance_of(candidate.gain, candidate.degrees, candidate.alternatives);
}

bool is_stuck(const Hypothesis& hypothesis) {
  return is_impossible(hypothesis) || promise_of(hypothesis) > kStuck_nats;
}

bool is_torque_impossible(const Hypothesis& hypothesis) {
  return hypothesis.estimate.noise.torque_Nm > kImpossibleTorque_Nm;
}

namespace {

/// The rough fits of one candidate, the best of which stays.
class RoughFits {
 public:
  RoughFits(Candidate& candidate, const Hypothesis& hypothesis, bool also_from_nominal)
      : candidate_(candidate),
        hypothesis_(hypothesis),
        also_from_nominal_(also_from_nominal),
        hopeless_(hypothesis.log_likelihood() - kHopeless_nats * hypothesis.estimate.readings) {}

  void from_starts() {
    std::size_t fits = 0;
    for (const Start& start : candidate_.starts) {
      if (fits > 0 && (fits >= kMaxFits || start.predicted_gain < kWorthAFit * candidate_.predicted_gain))
        break;
      if (info_of(*candidate_.effect).order_scan && gain() > start.predicted_gain) break;
      const bool other_shape = info_of(*candidate_.effect).parameters.size() > 1;
      if (fits > 0 && !other_shape && gain() > kStuck * candidate_.predicted_gain) break;
      ++fits;
      keep_if_better(fitted_from(start, hypothesis_, hypothesis_.estimate.noise.torque_Nm, kRoughIterations,
                                 Brake::Fitted, wanted()),
                     candidate_.fitted);
    }
    if (!candidate_.starts.empty()) afresh(candidate_.starts.front().values);
  }

  /// Other choices of its refinements, from where the best one ended.
  void refine() {
    const auto& parameters = info_of(*candidate_.effect).parameters;
    for (std::size_t i = 0; i < parameters.size() && candidate_.fitted.possible(); ++i) {
      if (parameters[i].role != Role::Refinement) continue;
      int misses = 0;
      for (std::size_t other = 1; other < parameters[i].starts.size() && misses < kMaxMisses; ++other)
        misses = chosen(i, parameters[i].starts[other]) ? 0 : misses + 1;
    }
  }

 private:
  double gain() const {
    return candidate_.fitted.possible() ? candidate_.fitted.log_likelihood() - hypothesis_.log_likelihood()
                                        : -std::numeric_limits<double>::infinity();
  }

  /// Of a further fit that is to count for something.
  double wanted() const {
    constexpr double kAny = -std::numeric_limits<double>::infinity();
    if (!candidate_.fitted.possible()) return kAny;
    return std::max(hopeless_, candidate_.fitted.log_likelihood() - kBehind_nats);
  }

  /// Whether this choice is better.
  bool chosen(std::size_t parameter, double choice) {
    const double reached = gain();
    const auto& parameters = info_of(*candidate_.effect).parameters;
    EffectValues values = candidate_.fitted.estimate.parameters.effects.back();
    values.values = chosen_otherwise(*candidate_.effect, values.values, parameter, choice);
    for (std::size_t j = 0; j < parameters.size(); ++j) {
      // From a bound a search hardly gets away.
      const double width = parameters[j].upper - parameters[j].lower;
      if (parameters[j].role == Role::Strength && values.values[j] > parameters[j].upper - 0.05 * width)
        values.values[j] = parameters[j].lower + 0.5 * width;
    }
    Hypothesis from = hypothesis_;
    from.estimate =
        without_effect(candidate_.fitted.estimate, candidate_.fitted.estimate.parameters.effects.size() - 1);
    keep_if_better(fitted_from({.values = values}, from, candidate_.fitted.estimate.noise.torque_Nm,
                               kRoughIterations, Brake::Fitted, wanted()),
                   candidate_.fitted);
    const bool better = gain() > reached;
    if (better)
      afresh(candidate_.fitted.estimate.parameters.effects.back());
    else if (is_brake_impossible(candidate_.fitted) || is_brake_impossible(hypothesis_))
      afresh(values);
    return better;
  }

  /// From the nominal brake.
  void afresh(const EffectValues& values) {
    if (!also_from_nominal_) return;
    Hypothesis fitted = fitted_from({.values = values}, hypothesis_, kModestTorque_Nm, kRoughIterations,
                                    Brake::Nominal, hopeless_);
    if (fitted.log_likelihood() < hopeless_) return;
    refit(fitted);
    keep_if_better(std::move(fitted), candidate_.fitted);
  }

  Candidate& candidate_;
  const Hypothesis& hypothesis_;
  bool also_from_nominal_;
  double hopeless_;
};

}  // namespace

void fit(Candidate& candidate, const Hypothesis& hypothesis, bool also_from_nominal) {
  RoughFits(candidate, hypothesis, also_from_nominal).from_starts();
  candidate.is_fitted = true;
  weigh(candidate, hypothesis);
}

void refine(Candidate& candidate, const Hypothesis& hypothesis, bool also_from_nominal) {
  RoughFits(candidate, hypothesis, also_from_nominal).refine();
  weigh(candidate, hypothesis);
}

void fit_from(const EffectValues& values, const Hypothesis& elsewhere, const Hypothesis& hypothesis,
              Candidate& candidate) {
  candidate.is_fitted = true;
  keep_if_better(
      fitted_from({.values = values}, elsewhere, elsewhere.estimate.noise.torque_Nm, kRoughIterations),
      candidate.fitted);
  weigh(candidate, hypothesis);
}

namespace {

/// Whether one of the friction's parameters has moved far from where it was without the effect, or lies near
/// the end of what is sensible: then the search may have followed a friction that had stood in for the
/// effect.
bool has_friction_moved(const Hypothesis& with, const Hypothesis& without) {
  constexpr double kFar_sd = 10.0;
  if (is_brake_impossible(with) || is_brake_impossible(without)) return true;
  const ParameterVector& now = with.estimate.parameters.base.theta;
  const ParameterVector& before = without.estimate.parameters.base.theta;
  for (const std::size_t parameter : {TC, Ts0, Tv, mus, ws}) {
    const auto i = static_cast<Eigen::Index>(parameter);
    const double variance = with.estimate.covariance(i, i);
    if (!(std::abs(now[i] - before[i]) < kFar_sd * std::sqrt(std::max(variance, 0.0)))) return true;
  }
  return false;
}

/// The effect as it was found, the friction from its nominal values: the friction of a model that lacks the
/// effect has been bent to stand in for it, and a descent does not always find back.
void from_another_friction(Candidate& candidate, const Hypothesis& hypothesis) {
  if (!candidate.fitted.possible() || !has_friction_moved(candidate.fitted, hypothesis)) return;
  Hypothesis elsewhere = hypothesis;
  elsewhere.estimate =
      without_effect(candidate.fitted.estimate, candidate.fitted.estimate.parameters.effects.size() - 1);
  ParameterVector& theta = elsewhere.estimate.parameters.base.theta;
  theta.tail<kParameterCount - 2>() = nominal_parameters().tail<kParameterCount - 2>();
  const double wanted = candidate.fitted.log_likelihood() + kHelps_nats;
  Hypothesis other =
      fitted_from({.values = candidate.fitted.estimate.parameters.effects.back()}, elsewhere,
                  kModestTorque_Nm, ExtendedFitOptions{}.max_iterations, Brake::Fitted, wanted);
  if (other.possible() && other.log_likelihood() > wanted) candidate.fitted = std::move(other);
}

}  // namespace

void finish(Candidate& candidate, const Hypothesis& hypothesis) {
  if (!candidate.fitted.possible()) return;
  Hypothesis settled = candidate.fitted;
  settle(settled);
  keep_if_better(std::move(settled), candidate.fitted);
  from_another_friction(candidate, hypothesis);
  if (candidate.fitted.estimate.noise.torque_Nm > kSuspiciousTorque_Nm) {
    // From a filter that believes the torque: where its own noise hid the effect. As long as that helps.
    std::vector<EffectValues> from{candidate.fitted.estimate.parameters.effects.back()};
    for (std::size_t i = 0; i < std::min<std::size_t>(2, candidate.starts.size()); ++i)
      from.push_back(candidate.starts[i].values);
    for (const EffectValues& values : from) {
      const double reached = candidate.fitted.log_likelihood();
      keep_if_better(
          fitted_from({.values = values}, hypothesis, kModestTorque_Nm, ExtendedFitOptions{}.max_iterations),
          candidate.fitted);
      if (candidate.fitted.log_likelihood() < reached + kHelps_nats) break;
    }
  }
  if (info_of(*candidate.effect).order_scan) {
    // Beside one period another stands out that the base model hides: perhaps that is the only one.
    Candidate beside;
    beside.effect = candidate.effect;
    const Hypothesis& fitted = candidate.fitted;
    add_peaks(fitted, filter_runs(fitted.runs, fitted.estimate, fitted.threads), beside);
    if (!beside.starts.empty() && beside.starts.front().predicted_gain > kStandsOut * candidate.gain &&
        room_for(candidate.fitted.estimate.parameters, {&beside.starts.front().values, 1})) {
      Hypothesis both = fitted_from(beside.starts.front(), candidate.fitted,
                                    candidate.fitted.estimate.noise.torque_Nm, kRoughIterations);
      const std::size_t first = candidate.fitted.estimate.parameters.effects.size() - 1;
      const auto is_first_needed = [&] {
        return both.estimate.covariance.allFinite() &&
               known_strength(both, first) > both.log_likelihood() - candidate.fitted.log_likelihood();
      };
      if (both.possible() && is_first_needed())
        candidate.twice = std::move(both);
      else if (both.possible())
        keep_if_better(fitted_from({.values = both.estimate.parameters.effects.back()}, hypothesis,
                                   kModestTorque_Nm, ExtendedFitOptions{}.max_iterations),
                       candidate.fitted);
    }
  }
  // One choice may only show its worth far from the neutral value, where another one leads; refinements were
  // tried there.
  std::vector<Hypothesis> others;
  add_otherwise_chosen(candidate.fitted, candidate.fitted.estimate.parameters.effects.size() - 1,
                       {Role::Choice}, others);
  for (Hypothesis& other : others) keep_if_better(std::move(other), candidate.fitted);
  weigh(candidate, hypothesis);
}

void refit(Hypothesis& hypothesis, int max_iterations, double least) {
  ExtendedFitOptions options;
  options.max_iterations = max_iterations;
  options.least_log_likelihood = least - hypothesis.unused_log_likelihood;
  options.threads = hypothesis.threads;
  hypothesis.estimate = fit_extended(hypothesis.runs, hypothesis.estimate, options);
}

void settle(Hypothesis& hypothesis) {
  if (hypothesis.estimate.settled && promise_of(hypothesis) < kNotEnded_nats) return;
  const double begun = hypothesis.log_likelihood();
  refit(hypothesis);
  /// Once more, from what `change` makes of the estimate; whether that helped.
  const auto again = [&](const auto& change) {
    Hypothesis other = hypothesis;
    change(other.estimate);
    refit(other);
    const bool helps = other.log_likelihood() > hypothesis.log_likelihood() + kHelps_nats;
    keep_if_better(std::move(other), hypothesis);
    return helps;
  };
  const auto believe_the_torque = [](ExtendedEstimate& estimate) {
    estimate.noise.torque_Nm = kModestTorque_Nm;
  };
  // Noise of the torque and parameters can answer each other in ever smaller steps.
  if (!hypothesis.estimate.settled && hypothesis.estimate.noise.torque_Nm > kModestTorque_Nm)
    again(believe_the_torque);
  // A kink can end a descent where a step promises more; but what one fit from there could not leave, the
  // next one cannot either.
  bool moves = !hypothesis.estimate.settled || hypothesis.log_likelihood() > begun + kHelps_nats;
  for (int more = 0; moves && more < kMaxMisses && hypothesis.possible(); ++more)
    moves = promise_of(hypothesis) > kNotEnded_nats && again([](ExtendedEstimate&) {});
  if (hypothesis.possible() && is_stuck(hypothesis))
    again([&](ExtendedEstimate& estimate) {
      estimate.parameters.base.theta = nominal_parameters();
      believe_the_torque(estimate);
    });
}

Hypothesis without(const Hypothesis& hypothesis, std::size_t effect, std::span<const Run> recorded) {
  Hypothesis reduced = taken_out(hypothesis, effect, recorded);
  for (int fits = 1;; ++fits) {
    refit(reduced, kRoughIterations);
    const double near_enough =
        std::min(kNearEnough * (hypothesis.log_likelihood() - reduced.log_likelihood()), kStuck_nats);
    if (fits == kMaxMisses || !reduced.possible() || is_impossible(reduced) || near_enough <= kNotEnded_nats)
      break;
    if (promise_of(reduced) < near_enough) return reduced;
  }
  settle(reduced);
  return reduced;
}

Hypothesis without_any(const Hypothesis& hypothesis, std::span<const Run> recorded) {
  Hypothesis bare = hypothesis;
  while (!bare.estimate.parameters.effects.empty()) bare = taken_out(bare, 0, recorded);
  settle(bare);
  return bare;
}

std::vector<Hypothesis> otherwise_chosen(const Hypothesis& hypothesis) {
  std::vector<Hypothesis> list;
  for (std::size_t e = 0; e < hypothesis.estimate.parameters.effects.size(); ++e)
    add_otherwise_chosen(hypothesis, e, {Role::Choice, Role::Refinement}, list);
  return list;
}

}  // namespace clampd::diagnosing
