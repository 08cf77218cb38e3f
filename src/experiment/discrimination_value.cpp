#include "discrimination_value.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/identify/parameter_scores.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd {

namespace {

constexpr double kBudget_s = 3.0;
/// A rival that strays further does not do what the trajectory is about.
constexpr double kTrackingLimit_N = 1500.0;
/// Rivals that the runs so far allow do not differ by more standard deviations in one reading.
constexpr double kMaxCredible = 8.0;
/// Undetermined parameters stay as they are where the run does not move them either.
constexpr double kRidge = 1e-9;

/// Bounds and scale of one of ExtendedBrake's parameters, and the place of its value.
struct Entry {
  double* value;
  double lower, upper, scale;
  bool positive;  ///< by nature: a change is judged relative to it
};

std::vector<Entry> entries(ExtendedParameters& model, std::span<const ExtendedBrake::Place> places) {
  std::vector<Entry> all;
  for (const ExtendedBrake::Place& place : places) {
    if (place.effect < 0) {
      const ParameterInfo& info = kParameterTable[static_cast<std::size_t>(place.parameter)];
      all.push_back(
          {&value_at(model, place), info.lower, info.upper, std::abs(info.nominal), info.lower > 0.0});
      continue;
    }
    const EffectParameter& info = parameter_at(model, place);
    all.push_back({&value_at(model, place), info.lower, info.upper, info.scale, info.logarithmic});
  }
  return all;
}

/// Inverse of what is finite; nothing known of the rest.
Eigen::MatrixXd information_of(const RivalModel& rival) {
  ExtendedParameters model = rival.parameters;
  const ExtendedBrake brake(model);
  const std::vector<Entry> all = entries(model, brake.places());
  const auto size = static_cast<Eigen::Index>(all.size());
  std::vector<Eigen::Index> known;
  for (Eigen::Index i = 0; i < size; ++i)
    if (std::isfinite(rival.covariance(i, i))) known.push_back(i);
  Eigen::MatrixXd covariance = rival.covariance(known, known);
  Eigen::VectorXd deviation(covariance.rows());
  for (Eigen::Index i = 0; i < covariance.rows(); ++i) {
    const Entry& entry = all[static_cast<std::size_t>(known[static_cast<std::size_t>(i)])];
    const double smallest = 1e-6 * std::max(entry.scale, std::abs(*entry.value));
    covariance(i, i) = std::max(covariance(i, i), smallest * smallest);
    deviation[i] = std::sqrt(covariance(i, i));
  }
  Eigen::MatrixXd correlation = covariance.cwiseQuotient(deviation * deviation.transpose());
  correlation.diagonal().array() += kRidge;
  const Eigen::MatrixXd inverse = statistics::SymmetricFactor(correlation).inverse();
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(size, size);
  information(known, known) = inverse.cwiseQuotient(deviation * deviation.transpose());
  return information;
}

/// As a channel that is recorded late holds it: what it had at the start before anything came.
void record_late(std::vector<double>& channel, int by, double before) {
  const auto late = std::min<std::ptrdiff_t>(by, static_cast<std::ptrdiff_t>(channel.size()));
  std::rotate(channel.begin(), channel.end() - late, channel.end());
  std::fill_n(channel.begin(), late, before);
}

double solve_for(const Eigen::MatrixXd& information, const Eigen::VectorXd& gradient, Eigen::VectorXd& step) {
  step = statistics::ScaledFactor(information, kRidge).solve(gradient);
  return 0.5 * gradient.dot(step);
}

}  // namespace

int repeats_in_budget(std::size_t rows, const DiscriminationOptions& options) {
  return std::clamp(static_cast<int>(std::lround(kBudget_s / (static_cast<double>(rows) * kPeriod_s))), 1,
                    options.most_repeats);
}

Result<void> check_rivals(std::span<const RivalModel> rivals) {
  for (const RivalModel& rival : rivals) {
    const int size = ExtendedBrake(rival.parameters).parameters();
    if (rival.covariance.rows() != size || rival.covariance.cols() != size)
      return failure(fmt::format("rival {}: its covariance is {} x {}, but it has {} parameters", rival.name,
                                 rival.covariance.rows(), rival.covariance.cols(), size));
  }
  return {};
}

RivalComparison::RivalComparison(std::span<const RivalModel> rivals, const NoiseLevels& noise,
                                 const BrakeParameters& nominal, const DiscriminationOptions& options)
    : rivals_(rivals),
      noise_(noise),
      options_(options),
      loop_(nominal_drive(nominal), options.torque_limit_Nm) {
  for (const RivalModel& rival : rivals) prior_information_.push_back(information_of(rival));
}

RivalComparison::Tracked RivalComparison::track(const Reference& reference, const RivalModel& rival) const {
  const std::size_t size = reference.rows.size();
  const ExtendedBrake brake(rival.parameters);
  const PaperBrake base = paper_brake(rival.parameters.base);
  Tracked tracked;
  FitRun run;
  run.number = options_.run_number;
  run.use_force.assign(size, 1);
  run.use_velocity.assign(size, 1);
  double asked_Nm = 0.0, force_max_N = 0.0, speed_max_rad_s = 0.0, squares_N2 = 0.0;
  const auto command = [&](std::size_t k, const ExtendedBrake::State& state) {
    const ReferenceRow& row = reference.rows[std::min(k, size - 1)];
    const ReferenceRow& next = reference.rows[std::min(k + 1, size - 1)];
    const double torque = loop_.torque_Nm(row, next, base, BrakeState(state[0], state[1]));
    asked_Nm = std::max(asked_Nm, std::abs(torque));
    return std::clamp(torque, -options_.torque_limit_Nm, options_.torque_limit_Nm);
  };
  RowInput row{.gap_s = kPeriod_s, .run = run.number};
  ExtendedBrake::State state = brake.settled(0.0, 0.0, row);
  row.previous_torque_Nm = row.torque_Nm = row.next_torque_Nm = row.later_torque_Nm = command(0, state);
  state = brake.settled(0.0, 0.0, row);
  for (std::size_t k = 0; k < size; ++k) {
    row.time_s = static_cast<double>(k) * kPeriod_s;
    row.next_torque_Nm = row.later_torque_Nm = row.torque_Nm;
    // As on the bench, the next command is decided before its row, from where the brake will be.
    row.next_torque_Nm = row.later_torque_Nm = command(k + 1, brake.advance(state, row));
    const Reading reading = brake.read(state, row);
    run.time_s.push_back(row.time_s);
    run.torque_Nm.push_back(row.torque_Nm);
    run.force_N.push_back(reading.force_N);
    run.velocity_rad_s.push_back(reading.velocity_rad_s);
    const double force_N = base.stiffness().force_N(state[0]);
    force_max_N = std::max({force_max_N, force_N, reading.force_N});
    speed_max_rad_s = std::max(speed_max_rad_s, std::abs(state[1]));
    squares_N2 += (force_N - reference.rows[k].force_N) * (force_N - reference.rows[k].force_N);
    state = brake.advance(state, row);
    row.previous_torque_Nm = row.torque_Nm;
    row.torque_Nm = row.next_torque_Nm;
    if (!ExtendedBrake::is_bounded(state)) {
      tracked.infeasible = fmt::format("{} leaves all bounds", rival.name);
      return tracked;
    }
  }
  const double rms_N = std::sqrt(squares_N2 / static_cast<double>(size));
  if (force_max_N > options_.force_limit_N)
    tracked.infeasible = fmt::format("{} would reach {:.0f} N", rival.name, force_max_N);
  else if (speed_max_rad_s > options_.velocity_limit_rad_s)
    tracked.infeasible = fmt::format("{} would reach {:.0f} rad/s", rival.name, speed_max_rad_s);
  else if (asked_Nm > options_.torque_limit_Nm)
    tracked.infeasible = fmt::format("{} would need {:.2f} N m", rival.name, asked_Nm);
  else if (rms_N > kTrackingLimit_N)
    tracked.infeasible = fmt::format("{} cannot follow it: {:.0f} N rms", rival.name, rms_N);
  const EffectDelays late = delays_of(rival.parameters);
  record_late(run.torque_Nm, late.torque, 0.0);
  record_late(run.force_N, late.force, run.force_N.front());
  record_late(run.velocity_rad_s, late.velocity, run.velocity_rad_s.front());
  tracked.runs = {std::move(run)};
  return tracked;
}

RivalComparison::Evidence RivalComparison::against(const std::vector<FitRun>& recorded, std::size_t index,
                                                   int repeats, int relinearisations) const {
  const RivalModel& rival = rivals_[index];
  const Eigen::MatrixXd& prior = prior_information_[index];
  std::vector<FitRun> runs = recorded;
  const EffectDelays delays = delays_of(rival.parameters);
  move_by(delays, runs);
  // Readings that a late channel has of the time before the run.
  drop_unusable(delays, runs);
  ExtendedEstimate estimate;
  estimate.parameters = rival.parameters;
  estimate.noise = noise_;
  const ExtendedBrake shape(rival.parameters);
  estimate.initial_states.push_back(
      Eigen::VectorXd::Zero(2 + static_cast<Eigen::Index>(shape.free_states().size())));
  const std::vector<Entry> all = entries(estimate.parameters, shape.places());
  const auto size = static_cast<Eigen::Index>(all.size());
  Eigen::VectorXd moved = Eigen::VectorXd::Zero(size), step;
  Evidence best{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(),
                std::numeric_limits<double>::infinity()};
  for (int round = 0;; ++round) {
    const ParameterScores scores = score_parameters(runs, estimate);
    if (!scores.possible) break;
    const auto left = [&](double count) {
      const Eigen::VectorXd gradient = count * scores.gradient - prior * moved;
      const double spent = count * scores.half_squares + 0.5 * moved.dot(prior * moved);
      return std::max(0.0, spent - solve_for(count * scores.information + prior, gradient, step));
    };
    best.of_one = std::min(best.of_one, left(1.0));
    best.of_many = std::min(best.of_many, left(repeats));
    best.largest_innovation = std::min(best.largest_innovation, scores.largest_innovation);
    if (round >= relinearisations) break;
    for (Eigen::Index i = 0; i < size; ++i) {
      const Entry& entry = all[static_cast<std::size_t>(i)];
      const double before = *entry.value;
      double after = before + step[i];
      if (entry.positive) after = std::clamp(after, 0.4 * before, 2.5 * before);
      *entry.value = std::clamp(after, entry.lower, entry.upper);
      moved[i] += *entry.value - before;
    }
  }
  return best;
}

RivalComparison::Evidence RivalComparison::hardest(const Reference& reference, int repeats,
                                                   int relinearisations, DiscriminationValue& value) const {
  Evidence least{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(), 0.0};
  value = {};
  std::vector<Tracked> tracked;
  for (const RivalModel& rival : rivals_) {
    tracked.push_back(track(reference, rival));
    if (!tracked.back().infeasible.empty()) {
      value.infeasible = tracked.back().infeasible;
      return {};
    }
  }
  value.feasible = value.credible = true;
  for (std::size_t truth = 0; truth < rivals_.size(); ++truth)
    for (std::size_t other = 0; other < rivals_.size(); ++other) {
      if (other == truth) continue;
      const Evidence evidence = against(tracked[truth].runs, other, repeats, relinearisations);
      least.of_one = std::min(least.of_one, evidence.of_one);
      value.credible = value.credible && evidence.largest_innovation <= kMaxCredible;
      if (evidence.of_many >= least.of_many) continue;
      least.of_many = evidence.of_many;
      value.first = std::min(truth, other);
      value.second = std::max(truth, other);
    }
  // Nothing bounded that any rival could say of another's readings: as far apart as can be.
  constexpr double kAll = 1e9;
  return {std::min(least.of_one, kAll), std::min(least.of_many, kAll), 0.0};
}

DiscriminationValue RivalComparison::evaluate(const Reference& reference, int relinearisations) const {
  const int repeats = repeats_in_budget(reference.rows.size(), options_);
  DiscriminationValue value;
  const Evidence evidence = hardest(reference, repeats, relinearisations, value);
  value.evidence_nats = evidence.of_one;
  value.evidence_per_sample_nats =
      evidence.of_many / (static_cast<double>(repeats) * static_cast<double>(reference.rows.size()));
  return value;
}

double RivalComparison::evidence_after(const Reference& reference, int repeats, int relinearisations) const {
  DiscriminationValue value;
  return hardest(reference, repeats, relinearisations, value).of_many;
}

Result<DiscriminationValue> evaluate_discrimination(const Run& trajectory, std::span<const RivalModel> rivals,
                                                    const NoiseLevels& noise, const BrakeParameters& nominal,
                                                    const DiscriminationOptions& options) {
  if (rivals.size() < 2)
    return failure(fmt::format("a discrimination needs two rivals or more, not {}", rivals.size()));
  Result<void> valid = options.validate();
  if (valid) valid = check_rivals(rivals);
  if (!valid) return tl::unexpected(valid.error());
  const Result<Reference> reference = build_reference(trajectory, nominal);
  if (!reference) return tl::unexpected(reference.error());
  return RivalComparison(rivals, noise, nominal, options).evaluate(*reference, kCarefulRelinearisations);
}

}  // namespace clampd
