#include "src/diagnose/hypothesis.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <initializer_list>
#include <limits>
#include <numbers>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <boost/math/special_functions/sinc.hpp>

#include "clampd/base/parallel.hpp"
#include "src/diagnose/evidence.hpp"

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
/// No drive's torque is as noisy as this.
constexpr double kImpossibleTorque_Nm = 0.05;
constexpr std::size_t kMostFits = 4;
/// The same of further choices, one after the other, that bring nothing more.
constexpr int kMostMisses = 3;
/// Enough to see whether a candidate is among the best; those are then fitted to the end.
constexpr int kRoughIterations = 14;

/// Scan of a periodic torque over the motor angle: finer than what one run over the whole travel resolves.
constexpr double kScanFirst = 0.4;
constexpr double kScanLast = 90.0;
constexpr double kScanStep = 0.12;
constexpr std::size_t kPeaks = 2;
constexpr double kNeighbourhood = 0.5;
/// A second period beside one that promises this share of what the first has brought may be the true one.
constexpr double kStandsOut = 0.1;
constexpr double kFineStep = 0.025;
constexpr Eigen::Index kScanTogether = 64;  // orders that fit the cache

constexpr double kSpikeDegrees = 2.0;

std::vector<std::vector<double>> combinations(const Effect& effect, std::span<const Run> recorded) {
  const auto& parameters = info_of(effect).parameters;
  std::vector<std::vector<double>> list{{}};
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    std::vector<double> values = starts_of(effect, i, recorded);
    if (parameters[i].role == Role::Strength) values.insert(values.begin(), parameters[i].neutral);
    if (parameters[i].role == Role::Refinement) values.resize(1);
    std::vector<std::vector<double>> longer;
    for (const auto& begun : list)
      for (const double value : values) {
        longer.push_back(begun);
        longer.back().push_back(value);
      }
    list = std::move(longer);
  }
  return list;
}

/// Alternatives tried: choices, and shapes, of which nothing is known where the effect is absent, so that the
/// best of many is taken (Davies 1987).
double choices_of(const Effect& effect) {
  double count = 1.0;
  for (const EffectParameter& parameter : info_of(effect).parameters)
    if (parameter.role != Role::Strength)
      count *= std::max<double>(1.0, static_cast<double>(parameter.starts.size()));
  return count;
}

Eigen::Index estimated_of(const Effect& effect) {
  const auto& parameters = info_of(effect).parameters;
  return std::count_if(parameters.begin(), parameters.end(), is_estimated);
}

double degrees_of(const Effect& effect, std::size_t runs) {
  const EffectInfo& info = info_of(effect);
  double degrees =
      info.free_states_count ? static_cast<double>(info.free_states) * static_cast<double>(runs) : 0.0;
  degrees += static_cast<double>(estimated_of(effect));
  // Spikes have no equations; their share and size are what is estimated.
  return degrees > 0.0 ? degrees : kSpikeDegrees;
}

/// The effect at the end of the step that the forecast proposes, within its bounds; what it promises is void
/// where a one-sided strength would have to go below its neutral value.
Start start_from(const Effect& effect, const std::vector<double>& values, const Hypothesis& hypothesis,
                 const StepForecast& forecast) {
  const auto& parameters = info_of(effect).parameters;
  const Eigen::Index own = forecast.step.size() - estimated_of(effect);
  Start start{
      {&effect, values}, forecast.after_step - hypothesis.estimate.log_likelihood, forecast.step.head(own)};
  const auto strengths = std::count_if(parameters.begin(), parameters.end(),
                                       [](const auto& each) { return each.role == Role::Strength; });
  Eigen::Index at = forecast.step.size();
  for (std::size_t i = parameters.size(); i-- > 0;) {
    const EffectParameter& parameter = parameters[i];
    if (!is_estimated(parameter)) continue;
    const double move = forecast.step[--at];
    if (parameter.role == Role::Strength) {
      if (values[i] + move < parameter.lower && parameter.lower == parameter.neutral)
        start.predicted_gain = 0.0;
      const double width = parameter.upper - parameter.lower;
      start.values.values[i] = std::clamp(
          values[i] + move, parameter.lower + 1e-4 * width * (parameter.lower == parameter.neutral),
          parameter.upper - 0.02 * width);
    } else if (info_of(effect).free_states == 0 && strengths == 0) {
      // Nothing but a shape: the step moves it.
      const double moved = parameter.logarithmic
                               ? values[i] * std::exp(std::clamp(move / values[i], -0.7, 0.7))
                               : values[i] + move;
      start.values.values[i] = std::clamp(moved, parameter.lower, parameter.upper);
    }
  }
  return start;
}

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

Hypothesis fitted_from(const Start& start, const Hypothesis& hypothesis, double torque_noise_Nm,
                       int max_iterations, Brake brake = Brake::Fitted) {
  Hypothesis extended = hypothesis;
  extended.estimate = with_effect(hypothesis.estimate, start.values);
  const EffectDelays delays = delays_of(start.values);
  move_by(delays, extended.runs);
  if (start.step.size() > 0) follow(start, extended);
  extended.estimate.noise.torque_Nm = torque_noise_Nm;
  if (brake == Brake::Nominal) extended.estimate.parameters.base.theta = nominal_parameters();
  refit(extended, max_iterations);
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

void keep_if_better(Hypothesis&& other, Hypothesis& kept) {
  if (!other.possible()) return;
  if (!kept.possible() || other.log_likelihood() > kept.log_likelihood()) kept = std::move(other);
}

/// What a step of all its parameters together would still bring (nats).
double promise_of(const Hypothesis& hypothesis) {
  const StepForecast step = forecast(hypothesis.runs, hypothesis.estimate, hypothesis.threads);
  return step.after_step - step.log_likelihood;
}

/// With this effect's choices of these roles made otherwise, one at a time.
void add_otherwise_chosen(const Hypothesis& hypothesis, std::size_t effect, std::initializer_list<Role> roles,
                          std::vector<Hypothesis>& list) {
  const EffectValues& values = hypothesis.estimate.parameters.effects[effect];
  const EffectInfo& info = info_of(*values.effect);
  if (!delays_of(values).none() || info.name == kSpikes) return;
  for (std::size_t i = 0; i < info.parameters.size(); ++i) {
    if (std::find(roles.begin(), roles.end(), info.parameters[i].role) == roles.end()) continue;
    for (const double choice : info.parameters[i].starts) {
      Hypothesis other = hypothesis;
      EffectValues& chosen = other.estimate.parameters.effects[effect];
      chosen.values = chosen_otherwise(*values.effect, values.values, i, choice);
      if (choice == values.values[i] || !delays_of(chosen).none()) continue;
      refit(other, kRoughIterations);
      if (other.possible()) list.push_back(std::move(other));
    }
  }
}

/// Whether its starts are peaks of a scan, each of which promises about what it can bring.
bool is_scanned(const Effect& effect) {
  return info_of(effect).name == "cogging";
}

/// A grid of orders of a torque that is periodic in the motor angle.
struct Orders {
  double first, step;
  Eigen::Index count;
  double operator[](Eigen::Index i) const { return first + step * static_cast<double>(i); }
};

/// What each order promises.
std::vector<Start> scan(const Orders& orders, const Effect& effect, const SignalScorer& scorer,
                        std::span<const FilteredRun> filtered, const SpareThreads& threads) {
  const EffectInfo& info = info_of(effect);
  std::vector<Start> found(static_cast<std::size_t>(orders.count));
  const auto blocks = static_cast<std::size_t>((orders.count + kScanTogether - 1) / kScanTogether);
  for_each_index(blocks, threads, [&](std::size_t block) {
    const Eigen::Index first = static_cast<Eigen::Index>(block) * kScanTogether;
    const Eigen::Index count = std::min(kScanTogether, orders.count - first);
    SignalColumns signals{SignalColumns::Kind::Torque, {}};
    for (const FilteredRun& run : filtered) {
      const Eigen::Index last = static_cast<Eigen::Index>(run.position_rad.size()) - 1;
      Eigen::MatrixXd rows(last + 1, 2 * count);
      for (Eigen::Index k = 0; k <= last; ++k) {
        const double from = run.position_rad[static_cast<std::size_t>(k)];
        const double to = run.position_rad[static_cast<std::size_t>(std::min(k + 1, last))];
        for (Eigen::Index i = 0; i < count; ++i) {
          // The mean over the way to the next row.
          const double angle = 0.5 * orders[first + i] * (from + to);
          const double half = 0.5 * orders[first + i] * (to - from);
          const double mean = boost::math::sinc_pi(half);
          rows(k, 2 * i) = -mean * std::sin(angle);
          rows(k, 2 * i + 1) = -mean * std::cos(angle);
        }
      }
      signals.rows.push_back(std::move(rows));
    }
    const SignalScores scores = scorer.score(signals, 2);
    for (Eigen::Index i = 0; i < count; ++i) {
      const Eigen::Matrix2d information = scores.information.block<2, 2>(2 * i, 2 * i);
      const Eigen::Vector2d score = scores.score.segment<2>(2 * i);
      Start& start = found[static_cast<std::size_t>(first + i)];
      start.values = {&effect, {0.0, 0.0, orders[first + i]}};
      if (information.determinant() > 1e-9 * information.trace() * information.trace()) {
        const Eigen::Vector2d amplitude = information.ldlt().solve(score);
        start.predicted_gain = 0.5 * score.dot(amplitude);
        for (std::size_t p = 0; p < 2; ++p)
          start.values.values[p] = std::clamp(amplitude[static_cast<Eigen::Index>(p)],
                                              0.9 * info.parameters[p].lower, 0.9 * info.parameters[p].upper);
      }
    }
  });
  return found;
}

/// Starts at the peaks of what a scan over the orders promises. Runs over a short stretch of the motor angle
/// make peaks beside the true one, too close for the scan, that a fit does not leave: the best are looked at
/// closely.
void add_peaks(const Hypothesis& hypothesis, Candidate& candidate) {
  const std::vector<FilteredRun> filtered =
      filter_runs(hypothesis.runs, hypothesis.estimate, hypothesis.threads);
  if (filtered.empty()) return;
  const SignalScorer scorer(hypothesis.runs, hypothesis.estimate, hypothesis.threads);
  const Orders all{kScanFirst, kScanStep,
                   static_cast<Eigen::Index>((kScanLast - kScanFirst) / kScanStep) + 1};
  const auto promises_more = [](const Start& a, const Start& b) {
    return a.predicted_gain > b.predicted_gain;
  };
  const auto order = [](const Start& start) { return start.values.values[2]; };
  std::vector<Start> rough = scan(all, *candidate.effect, scorer, filtered, hypothesis.threads);
  std::sort(rough.begin(), rough.end(), promises_more);
  std::vector<double> centres;
  for (const Start& start : rough) {
    if (centres.size() == kPeaks) break;
    if (std::any_of(centres.begin(), centres.end(),
                    [&](double other) { return std::abs(other - order(start)) < 2.0 * kNeighbourhood; }))
      continue;
    centres.push_back(order(start));
    const double first = std::max(kScanFirst, order(start) - kNeighbourhood);
    const std::vector<Start> fine =
        scan({first, kFineStep, static_cast<Eigen::Index>(2.0 * kNeighbourhood / kFineStep) + 1},
             *candidate.effect, scorer, filtered, hypothesis.threads);
    for (std::size_t i = 1; i + 1 < fine.size(); ++i)
      if (promises_more(fine[i], fine[i - 1]) && !promises_more(fine[i + 1], fine[i]))
        candidate.starts.push_back(fine[i]);
  }
  std::sort(candidate.starts.begin(), candidate.starts.end(), promises_more);
  if (candidate.starts.size() > kMostFits) candidate.starts.resize(kMostFits);
  // Neighbours of the grid see the same: so many of them are different questions.
  candidate.alternatives = 0.5 * static_cast<double>(all.count);
}

/// One set of values of a candidate, and what a step from there promises.
struct Look {
  std::size_t candidate;
  EffectValues values;
  StepForecast seen;
};

/// Whether an effect with these values is there in name only.
bool is_neutral(const EffectValues& values) {
  const auto& parameters = info_of(*values.effect).parameters;
  bool has_strength = false;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    if (parameters[i].role != Role::Strength) continue;
    if (values.values[i] != parameters[i].neutral) return false;
    has_strength = true;
  }
  return has_strength;
}

/// Those that one linearisation can tell of.
std::vector<std::vector<Look*>> looks_together(const Hypothesis& hypothesis, std::vector<Look>& looks) {
  std::vector<std::vector<Look*>> batches;
  std::vector<Look*> batch;
  std::vector<EffectValues> effects;
  const auto close = [&] {
    if (!batch.empty()) batches.push_back(std::move(batch));
    batch.clear();
    effects.clear();
  };
  for (Look& look : looks) {
    if (!is_neutral(look.values) || info_of(*look.values.effect).free_states > 0) {
      batches.push_back({&look});
      continue;
    }
    effects.push_back(look.values);
    if (!batch.empty() && !room_for(hypothesis, effects)) {
      close();
      effects.push_back(look.values);
    }
    batch.push_back(&look);
  }
  close();
  return batches;
}

void take(const Hypothesis& hypothesis, const std::vector<Look*>& batch) {
  if (batch.size() == 1) {
    Look& look = *batch.front();
    look.seen = forecast(hypothesis.runs, with_effect(hypothesis.estimate, look.values), hypothesis.threads);
    return;
  }
  std::vector<EffectValues> effects;
  for (const Look* look : batch) effects.push_back(look->values);
  std::vector<StepForecast> seen =
      forecast_each(hypothesis.runs, hypothesis.estimate, effects, hypothesis.threads);
  for (std::size_t i = 0; i < batch.size(); ++i) batch[i]->seen = std::move(seen[i]);
}

/// The start that a look shows, and how well its strengths can be seen.
void add_start(const Hypothesis& hypothesis, const Look& look, Candidate& candidate) {
  if (look.seen.step.size() == 0) return;
  const auto& parameters = info_of(*candidate.effect).parameters;
  candidate.starts.push_back(start_from(*candidate.effect, look.values.values, hypothesis, look.seen));
  if (!is_neutral(look.values)) return;
  // Strengths come last or before shapes; the best known one counts.
  Eigen::Index at = look.seen.sd.size();
  double blindness = 0.0;
  for (std::size_t i = parameters.size(); i-- > 0;) {
    if (!is_estimated(parameters[i])) continue;
    --at;
    if (parameters[i].role == Role::Strength)
      blindness = std::max(blindness, look.seen.sd[at] / parameters[i].scale);
  }
  candidate.blindness = candidate.blindness > 0.0 ? std::min(candidate.blindness, blindness) : blindness;
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
  const double nats = 0.5 * distance.dot(known.ldlt().solve(distance));
  return std::isfinite(nats) ? nats : std::numeric_limits<double>::infinity();
}

void weigh(Candidate& candidate, const Hypothesis& hypothesis) {
  candidate.gain = std::max(0.0, candidate.fitted.log_likelihood() - hypothesis.log_likelihood());
  candidate.evidence = evidence_of(candidate.gain, candidate.degrees, candidate.alternatives);
}

bool room_for(const Hypothesis& hypothesis, std::span<const EffectValues> further) {
  int states = 2;
  std::size_t parameters = kParameterCount;
  const auto add = [&](const EffectValues& values) {
    states += info_of(*values.effect).states;
    parameters += values.values.size();
  };
  std::for_each(hypothesis.estimate.parameters.effects.begin(), hypothesis.estimate.parameters.effects.end(),
                add);
  std::for_each(further.begin(), further.end(), add);
  return states <= ExtendedBrake::kMostStates &&
         parameters <= static_cast<std::size_t>(ExtendedBrake::kMostParameters);
}

std::vector<Candidate> look_at(std::span<const Effect* const> tried, const Hypothesis& hypothesis,
                               std::span<const Run> recorded) {
  std::vector<Candidate> candidates(tried.size());
  std::vector<Look> looks;
  std::vector<std::function<void()>> work;
  for (std::size_t i = 0; i < tried.size(); ++i) {
    Candidate& candidate = candidates[i];
    const Effect& effect = *tried[i];
    candidate.effect = &effect;
    candidate.degrees = degrees_of(effect, hypothesis.runs.size());
    candidate.alternatives = choices_of(effect);
    if (info_of(effect).name == kSpikes) {
      work.emplace_back([&] { candidate = look_for_outliers(hypothesis); });
    } else if (is_scanned(effect)) {
      work.emplace_back([&] { add_peaks(hypothesis, candidate); });
    } else {
      for (std::vector<double>& values : combinations(effect, recorded))
        looks.push_back({i, {&effect, std::move(values)}, {}});
    }
  }
  const std::vector<std::vector<Look*>> together = looks_together(hypothesis, looks);
  for (const std::vector<Look*>& batch : together) work.emplace_back([&] { take(hypothesis, batch); });
  for_each_index(work.size(), hypothesis.threads, [&](std::size_t i) { work[i](); });
  for (const Look& look : looks) add_start(hypothesis, look, candidates[look.candidate]);
  for (Candidate& candidate : candidates) {
    if (candidate.is_fitted) continue;
    std::sort(candidate.starts.begin(), candidate.starts.end(),
              [](const Start& a, const Start& b) { return a.predicted_gain > b.predicted_gain; });
    if (!candidate.starts.empty()) candidate.predicted_gain = candidate.starts.front().predicted_gain;
    candidate.predicted_evidence =
        evidence_of(candidate.predicted_gain, candidate.degrees, candidate.alternatives);
  }
  return candidates;
}

bool is_stuck(const Hypothesis& hypothesis) {
  if (is_torque_impossible(hypothesis) || is_brake_impossible(hypothesis)) return true;
  return promise_of(hypothesis) > kStuck_nats;
}

bool is_torque_impossible(const Hypothesis& hypothesis) {
  return hypothesis.estimate.noise.torque_Nm > kImpossibleTorque_Nm;
}

void fit(Candidate& candidate, const Hypothesis& hypothesis, bool also_afresh) {
  candidate.is_fitted = true;
  const double noise = hypothesis.estimate.noise.torque_Nm;
  Hypothesis best = candidate.fitted;
  std::size_t fits = 0;
  const auto gain = [&] {
    return best.possible() ? best.log_likelihood() - hypothesis.log_likelihood()
                           : -std::numeric_limits<double>::infinity();
  };
  const auto attempt = [&](const Start& start, double torque_noise_Nm) {
    ++fits;
    keep_if_better(fitted_from(start, hypothesis, torque_noise_Nm, kRoughIterations), best);
  };
  for (const Start& start : candidate.starts) {
    if (fits > 0 && (fits >= kMostFits || start.predicted_gain < kWorthAFit * candidate.predicted_gain))
      break;
    if (is_scanned(*candidate.effect) && gain() > start.predicted_gain) break;
    const bool other_shape = info_of(*candidate.effect).parameters.size() > 1;
    if (fits > 0 && !other_shape && gain() > kStuck * candidate.predicted_gain) break;
    attempt(start, noise);
  }
  const auto attempt_afresh = [&](const EffectValues& values) {
    if (!also_afresh) return;
    Hypothesis afresh =
        fitted_from({.values = values}, hypothesis, kModestTorque_Nm, kRoughIterations, Brake::Nominal);
    if (afresh.log_likelihood() < hypothesis.log_likelihood() - kHopeless_nats * hypothesis.estimate.readings)
      return;
    refit(afresh);
    keep_if_better(std::move(afresh), best);
  };
  if (!candidate.starts.empty()) attempt_afresh(candidate.starts.front().values);
  const auto& parameters = info_of(*candidate.effect).parameters;
  for (std::size_t i = 0; i < parameters.size() && best.possible(); ++i) {
    if (parameters[i].role != Role::Refinement) continue;
    int misses = 0;
    for (std::size_t other = 1; other < parameters[i].starts.size(); ++other) {
      const double reached = gain();
      EffectValues values = best.estimate.parameters.effects.back();
      values.values = chosen_otherwise(*candidate.effect, values.values, i, parameters[i].starts[other]);
      for (std::size_t j = 0; j < parameters.size(); ++j) {
        // From a bound a search hardly gets away.
        const double width = parameters[j].upper - parameters[j].lower;
        if (parameters[j].role == Role::Strength && values.values[j] > parameters[j].upper - 0.05 * width)
          values.values[j] = parameters[j].lower + 0.5 * width;
      }
      Hypothesis from = hypothesis;
      from.estimate = without_effect(best.estimate, best.estimate.parameters.effects.size() - 1);
      keep_if_better(fitted_from({.values = values}, from, best.estimate.noise.torque_Nm, kRoughIterations),
                     best);
      const bool better = gain() > reached;
      if (better)
        attempt_afresh(best.estimate.parameters.effects.back());
      else if (is_brake_impossible(best) || is_brake_impossible(hypothesis))
        attempt_afresh(values);
      misses = better ? 0 : misses + 1;
      if (misses == kMostMisses) break;
    }
  }
  candidate.gain = std::max(0.0, gain());
  if (best.possible()) candidate.fitted = std::move(best);
  candidate.evidence = evidence_of(candidate.gain, candidate.degrees, candidate.alternatives);
}

void fit_from(const EffectValues& values, const Hypothesis& elsewhere, const Hypothesis& hypothesis,
              Candidate& candidate) {
  candidate.is_fitted = true;
  keep_if_better(
      fitted_from({.values = values}, elsewhere, elsewhere.estimate.noise.torque_Nm, kRoughIterations),
      candidate.fitted);
  if (candidate.fitted.possible()) weigh(candidate, hypothesis);
}

void finish(Candidate& candidate, const Hypothesis& hypothesis) {
  if (!candidate.fitted.possible()) return;
  Hypothesis settled = candidate.fitted;
  settle(settled);
  keep_if_better(std::move(settled), candidate.fitted);
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
  if (info_of(*candidate.effect).repeatable) {
    // Beside one period another stands out that the base model hides: perhaps that is the only one.
    Candidate beside;
    beside.effect = candidate.effect;
    add_peaks(candidate.fitted, beside);
    if (!beside.starts.empty() && beside.starts.front().predicted_gain > kStandsOut * candidate.gain) {
      const Hypothesis both = fitted_from(beside.starts.front(), candidate.fitted,
                                          candidate.fitted.estimate.noise.torque_Nm, kRoughIterations);
      const std::size_t first = candidate.fitted.estimate.parameters.effects.size() - 1;
      const bool is_first_needed =
          both.estimate.covariance.allFinite() &&
          known_strength(both, first) > both.log_likelihood() - candidate.fitted.log_likelihood();
      if (both.possible() && !is_first_needed)
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

void refit(Hypothesis& hypothesis, int max_iterations) {
  ExtendedFitOptions options;
  options.max_iterations = max_iterations;
  options.threads = hypothesis.threads;
  hypothesis.estimate = fit_extended(hypothesis.runs, hypothesis.estimate, options);
}

void settle(Hypothesis& hypothesis) {
  if (hypothesis.estimate.settled && promise_of(hypothesis) < kNotEnded_nats) return;
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
  // A kink can end a descent where a step promises more.
  for (int more = 0; more < kMostMisses && hypothesis.possible() && promise_of(hypothesis) > kNotEnded_nats;
       ++more)
    if (!again([](ExtendedEstimate&) {})) break;
  if (hypothesis.possible() && is_stuck(hypothesis))
    again([&](ExtendedEstimate& estimate) {
      estimate.parameters.base.theta = nominal_parameters();
      believe_the_torque(estimate);
    });
}

Hypothesis without(const Hypothesis& hypothesis, std::size_t effect, std::span<const Run> recorded) {
  Hypothesis reduced;
  reduced.threads = hypothesis.threads;
  reduced.estimate = without_effect(hypothesis.estimate, effect);
  const EffectValues& removed = hypothesis.estimate.parameters.effects[effect];
  reduced.runs = hypothesis.runs;
  reduced.unused_log_likelihood = hypothesis.unused_log_likelihood;
  reduced.degrees = hypothesis.degrees - degrees_of(*removed.effect, recorded.size());
  const EffectDelays delays = delays_of(removed);
  if (!delays.none() || info_of(*removed.effect).name == kSpikes) {
    // The readings as recorded, and then as the effects that are left see them.
    reduced.runs = fit_runs(recorded);
    reduced.unused_log_likelihood = 0.0;
    for (const EffectValues& left : reduced.estimate.parameters.effects) {
      move_by(delays_of(left), reduced.runs);
    }
  }
  reduced.estimate.settled = false;
  settle(reduced);
  return reduced;
}

std::vector<Hypothesis> otherwise_chosen(const Hypothesis& hypothesis) {
  std::vector<Hypothesis> list;
  for (std::size_t e = 0; e < hypothesis.estimate.parameters.effects.size(); ++e)
    add_otherwise_chosen(hypothesis, e, {Role::Choice, Role::Refinement}, list);
  return list;
}

}  // namespace clampd::diagnosing
