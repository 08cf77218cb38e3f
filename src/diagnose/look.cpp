#include "src/diagnose/look.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include <Eigen/LU>

#include "clampd/base/parallel.hpp"
#include "clampd/brake/effect_combinations.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/diagnose/evidence.hpp"

namespace clampd::diagnosing {

namespace {

using Role = EffectParameter::Role;

constexpr std::size_t kPeaks = 2;  // of a scan, that are looked at closely
constexpr std::size_t kMaxPeaks = 4;
constexpr Eigen::Index kScanTogether = 64;  // orders that fit the cache

constexpr double kSpikeDegrees = 2.0;

/// What is looked at: strengths at their neutral value and their starts, shapes and choices at their starts.
std::vector<std::vector<double>> values_to_look_at(const Effect& effect, std::span<const Run> recorded) {
  return combinations(effect, [&](std::size_t i) {
    const EffectParameter& parameter = info_of(effect).parameters[i];
    std::vector<double> values = starts_of(effect, i, recorded);
    if (parameter.role == Role::Strength) values.insert(values.begin(), parameter.neutral);
    return values;
  });
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

/// A grid of orders of a torque that is periodic in the motor angle.
struct Orders {
  double first, step;
  Eigen::Index count;
  double operator[](Eigen::Index i) const { return first + step * static_cast<double>(i); }
};

/// Torques of amplitude one against the motor's, sine and cosine of each order: rows x 2 orders, each the
/// mean over the way from its row to the next.
Eigen::MatrixXd waves(const Orders& orders, std::span<const double> position_rad) {
  constexpr double kNoWay = 1e-3;  // of phase: no difference to divide by
  const auto rows = static_cast<Eigen::Index>(position_rad.size());
  const Eigen::Index count = orders.count;
  // Sines and cosines of evenly spaced orders turn by the same angle from one to the next.
  const auto turned = [&](Eigen::Index row, Eigen::ArrayXd& sine, Eigen::ArrayXd& cosine) {
    const double angle = position_rad[static_cast<std::size_t>(row)];
    const double by_sine = std::sin(orders.step * angle), by_cosine = std::cos(orders.step * angle);
    double s = std::sin(orders.first * angle), c = std::cos(orders.first * angle);
    for (Eigen::Index i = 0; i < count; ++i) {
      sine[i] = s;
      cosine[i] = c;
      const double next = s * by_cosine + c * by_sine;
      c = c * by_cosine - s * by_sine;
      s = next;
    }
  };
  Eigen::ArrayXd sine(count), cosine(count), next_sine(count), next_cosine(count);
  Eigen::MatrixXd means(rows, 2 * count);
  turned(0, next_sine, next_cosine);
  for (Eigen::Index k = 0; k < rows; ++k) {
    sine.swap(next_sine);
    cosine.swap(next_cosine);
    const Eigen::Index next = std::min(k + 1, rows - 1);
    turned(next, next_sine, next_cosine);
    const double way =
        position_rad[static_cast<std::size_t>(next)] - position_rad[static_cast<std::size_t>(k)];
    for (Eigen::Index i = 0; i < count; ++i) {
      const double phase = orders[i] * way;
      const bool moves = std::abs(phase) > kNoWay;
      means(k, 2 * i) = moves ? (next_cosine[i] - cosine[i]) / phase : -0.5 * (sine[i] + next_sine[i]);
      means(k, 2 * i + 1) = moves ? (sine[i] - next_sine[i]) / phase : -0.5 * (cosine[i] + next_cosine[i]);
    }
  }
  return means;
}

/// What each order promises.
std::vector<Start> scan(const Orders& orders, const Effect& effect, const SignalScorer& scorer,
                        std::span<const FilteredRun> filtered, const ThreadBudget& threads) {
  const EffectInfo& info = info_of(effect);
  std::vector<Start> found(static_cast<std::size_t>(orders.count));
  const auto blocks = static_cast<std::size_t>((orders.count + kScanTogether - 1) / kScanTogether);
  for_each_index(blocks, threads, [&](std::size_t block) {
    const Eigen::Index first = static_cast<Eigen::Index>(block) * kScanTogether;
    const Eigen::Index count = std::min(kScanTogether, orders.count - first);
    SignalColumns signals{SignalColumns::Kind::Torque, {}};
    for (const FilteredRun& run : filtered)
      signals.rows.push_back(waves({orders[first], orders.step, count}, run.position_rad));
    const SignalScores scores = scorer.score(signals, 2);
    for (Eigen::Index i = 0; i < count; ++i) {
      const Eigen::Matrix2d information = scores.information.block<2, 2>(2 * i, 2 * i);
      const Eigen::Vector2d score = scores.score.segment<2>(2 * i);
      Start& start = found[static_cast<std::size_t>(first + i)];
      start.values = {&effect, {0.0, 0.0, orders[first + i]}};
      if (information.determinant() > 1e-9 * information.trace() * information.trace()) {
        const Eigen::Vector2d amplitude = statistics::SymmetricFactor(information).solve(score);
        start.predicted_gain = 0.5 * score.dot(amplitude);
        for (std::size_t p = 0; p < 2; ++p)
          start.values.values[p] = std::clamp(amplitude[static_cast<Eigen::Index>(p)],
                                              0.9 * info.parameters[p].lower, 0.9 * info.parameters[p].upper);
      }
    }
  });
  return found;
}

/// One set of values of a candidate, and what a step from there promises.
struct Screening {
  std::size_t candidate;
  EffectValues values;
  StepForecast outcome;
};

/// Whether it changes nothing as long as its free states, if it has such, are settled.
bool is_silent(const EffectValues& values) {
  const auto& parameters = info_of(*values.effect).parameters;
  const bool has_strength = std::any_of(parameters.begin(), parameters.end(),
                                        [](const auto& each) { return each.role == Role::Strength; });
  return has_strength ? is_neutral(values) : info_of(*values.effect).free_states > 0;
}

/// Those that one linearisation can tell of.
std::vector<std::vector<Screening*>> screenings_together(const Hypothesis& hypothesis,
                                                         std::vector<Screening>& screenings) {
  std::vector<std::vector<Screening*>> batches;
  std::vector<Screening*> batch;
  std::vector<EffectValues> effects;
  const auto close = [&] {
    if (!batch.empty()) batches.push_back(std::move(batch));
    batch.clear();
    effects.clear();
  };
  for (Screening& screening : screenings) {
    if (!is_silent(screening.values)) {
      batches.push_back({&screening});
      continue;
    }
    effects.push_back(screening.values);
    if (!batch.empty() && !room_for(hypothesis.estimate.parameters, effects)) {
      close();
      effects.push_back(screening.values);
    }
    batch.push_back(&screening);
  }
  close();
  return batches;
}

void evaluate(const Hypothesis& hypothesis, const std::vector<Screening*>& batch) {
  if (batch.size() == 1) {
    Screening& screening = *batch.front();
    screening.outcome =
        forecast(hypothesis.runs, with_effect(hypothesis.estimate, screening.values), hypothesis.threads);
    return;
  }
  std::vector<EffectValues> effects;
  for (const Screening* screening : batch) effects.push_back(screening->values);
  std::vector<StepForecast> outcome =
      forecast_each(hypothesis.runs, hypothesis.estimate, effects, hypothesis.threads);
  for (std::size_t i = 0; i < batch.size(); ++i) batch[i]->outcome = std::move(outcome[i]);
}

/// The start that a look shows, and how well its strengths can be seen.
void add_start(const Hypothesis& hypothesis, const Screening& screening, Candidate& candidate) {
  if (screening.outcome.step.size() == 0) return;
  const auto& parameters = info_of(*candidate.effect).parameters;
  candidate.starts.push_back(
      start_from(*candidate.effect, screening.values.values, hypothesis, screening.outcome));
  if (!is_neutral(screening.values)) return;
  // Strengths come last or before shapes; of several, the worst known one counts.
  Eigen::Index at = screening.outcome.sd.size();
  double blindness = 0.0;
  for (std::size_t i = parameters.size(); i-- > 0;) {
    if (!is_estimated(parameters[i])) continue;
    --at;
    if (parameters[i].role == Role::Strength)
      blindness = std::max(blindness, screening.outcome.sd[at] / parameters[i].scale);
  }
  candidate.blindness = candidate.blindness > 0.0 ? std::min(candidate.blindness, blindness) : blindness;
}

}  // namespace

double degrees_of(const Effect& effect, std::size_t runs) {
  const EffectInfo& info = info_of(effect);
  double degrees =
      info.free_states_count ? static_cast<double>(info.free_states) * static_cast<double>(runs) : 0.0;
  degrees += static_cast<double>(estimated_of(effect));
  // Spikes have no equations; their share and size are what is estimated.
  return degrees > 0.0 ? degrees : kSpikeDegrees;
}

void predict(Candidate& candidate) {
  candidate.predicted_gain = candidate.starts.empty() ? 0.0 : candidate.starts.front().predicted_gain;
  candidate.predicted_significance_nats =
      significance_of(candidate.predicted_gain, candidate.degrees, candidate.alternatives);
}

void add_peaks(const Hypothesis& hypothesis, std::span<const FilteredRun> filtered, Candidate& candidate) {
  if (filtered.empty()) return;
  const SignalScorer scorer(hypothesis.runs, hypothesis.estimate, hypothesis.threads);
  const OrderScan& grid = *info_of(*candidate.effect).order_scan;
  const Orders all{grid.first, grid.step, static_cast<Eigen::Index>((grid.last - grid.first) / grid.step) + 1};
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
                    [&](double other) { return std::abs(other - order(start)) < 2.0 * grid.neighbourhood; }))
      continue;
    centres.push_back(order(start));
    const double first = std::max(grid.first, order(start) - grid.neighbourhood);
    const std::vector<Start> fine =
        scan({first, grid.fine_step, static_cast<Eigen::Index>(2.0 * grid.neighbourhood / grid.fine_step) + 1},
             *candidate.effect, scorer, filtered, hypothesis.threads);
    for (std::size_t i = 1; i + 1 < fine.size(); ++i)
      if (promises_more(fine[i], fine[i - 1]) && !promises_more(fine[i + 1], fine[i]))
        candidate.starts.push_back(fine[i]);
  }
  std::sort(candidate.starts.begin(), candidate.starts.end(), promises_more);
  if (candidate.starts.size() > kMaxPeaks) candidate.starts.resize(kMaxPeaks);
  // Neighbours of the grid see the same: so many of them are different questions.
  candidate.alternatives = 0.5 * static_cast<double>(all.count);
}

std::vector<Candidate> look_at(std::span<const Effect* const> tried, const Hypothesis& hypothesis,
                               std::span<const Run> recorded) {
  std::vector<Candidate> candidates(tried.size());
  std::vector<Screening> screenings;
  std::vector<std::function<void()>> work;
  const std::vector<FilteredRun> filtered =
      filter_runs(hypothesis.runs, hypothesis.estimate, hypothesis.threads);
  for (std::size_t i = 0; i < tried.size(); ++i) {
    Candidate& candidate = candidates[i];
    const Effect& effect = *tried[i];
    candidate.effect = &effect;
    candidate.degrees = degrees_of(effect, hypothesis.runs.size());
    candidate.alternatives = choices_of(effect);
    if (info_of(effect).removes_readings) {
      work.emplace_back([&] { candidate = look_for_spikes(effect, hypothesis, filtered); });
    } else if (info_of(effect).order_scan) {
      work.emplace_back([&] { add_peaks(hypothesis, filtered, candidate); });
    } else {
      for (std::vector<double>& values : values_to_look_at(effect, recorded))
        screenings.push_back({i, {&effect, std::move(values)}, {}});
    }
  }
  const std::vector<std::vector<Screening*>> together = screenings_together(hypothesis, screenings);
  for (const std::vector<Screening*>& batch : together)
    work.emplace_back([&] { evaluate(hypothesis, batch); });
  for_each_index(work.size(), hypothesis.threads, [&](std::size_t i) { work[i](); });
  for (const Screening& screening : screenings)
    add_start(hypothesis, screening, candidates[screening.candidate]);
  for (Candidate& candidate : candidates) {
    if (candidate.is_fitted) continue;
    std::sort(candidate.starts.begin(), candidate.starts.end(),
              [](const Start& a, const Start& b) { return a.predicted_gain > b.predicted_gain; });
    predict(candidate);
  }
  return candidates;
}

}  // namespace clampd::diagnosing
