#include "clampd/experiment/robust_design.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <memory>
#include <numeric>
#include <optional>
#include <random>

#include <fmt/format.h>
#include <nlopt.h>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/base/parallel.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/identify/expected_covariance.hpp"
#include "closed_loop.hpp"

namespace clampd {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Share of the torque limit that the nominal brake may use: the rest is for heavier friction.
constexpr double kNominalTorque = 0.9;
/// What a brake counts that the run does not identify: worse than any real design, and finite.
constexpr double kUnidentified = 0.0;
/// Step of the difference quotients, of the torque limit: the prior's average smooths the kinks of single
/// brakes over about as much.
constexpr double kDifferenceStep = 2e-4;
constexpr double kFeasible = 1e-4;
constexpr double kTightening = 0.005;  ///< for the brakes that the search does not see

constexpr int kExplorationEvaluations = 25;
constexpr int kImprovementEvaluations = 25;
constexpr int kPolishEvaluations = 60;
constexpr std::size_t kElite = 6;
constexpr std::size_t kRoundStarts = 8;
constexpr int kSeedingStarts = 48;  ///< of each cautious D design

/// Wide open, so that the search sees where the limits are broken, and by how much.
constexpr ReferenceOptions kOpen{.force_limit_N = 1e6, .velocity_limit_rad_s = 1e6, .torque_limit_Nm = 1e3};

constexpr double kStepLevel_N = 1000.0;
constexpr double kStepRise_s = 0.01;
constexpr double kLeastHold = 1.0 / 3.0;  ///< of the length

/// What a tracked trajectory tells of each of some brakes; smaller is better.
class RunScore {
 public:
  /// The target's trajectory must be a reference of the nominal brake.
  RunScore(const NoiseLevels& noise, const std::optional<RobustTarget>& target, const ClosedLoop& loop,
           const BrakeParameters& nominal, std::span<const BrakeParameters> brakes)
      : noise_(noise), target_(target) {
    if (!target_) return;
    const Reference reference = *build_reference(target_->beside, nominal, kOpen);
    TrackedRun run;
    for (const BrakeParameters& brake : brakes) {
      loop.track(reference, brake, run);
      beside_.push_back(contributions(brake, run));
    }
  }

  /// `at`: of the brakes; it has followed the trajectory to the end.
  double operator()(std::size_t at, const BrakeParameters& brake, const TrackedRun& run) const {
    if (!target_)
      return -log_det(initial_state_unknown(
          joint_information(brake, BrakeState::Zero(), Excitation{.torque_Nm = run.torque_Nm}, noise_)));
    const Contributions design = contributions(brake, run);
    double sum = 0.0;
    for (std::size_t method = 0; method < kMethods.size(); ++method) {
      const std::array both{beside_[at][method], design[method]};
      const std::array counts{target_->runs, target_->runs};
      const ParameterMatrix covariance = expected_covariance(both, counts);
      for (const Parameter parameter : target_->parameters) sum += std::log(covariance(parameter, parameter));
    }
    const double mean = sum / static_cast<double>(kMethods.size() * target_->parameters.size());
    return std::isfinite(mean) ? mean : kInfinity;
  }

 private:
  static constexpr std::array kMethods{Method::OutputError, Method::PredictionError};
  using Contributions = std::array<ExpectedContribution, kMethods.size()>;

  Contributions contributions(const BrakeParameters& brake, const TrackedRun& run) const {
    Contributions result;
    for (std::size_t method = 0; method < kMethods.size(); ++method)
      result[method] = expected_contribution(kMethods[method], brake, BrakeState::Zero(),
                                             Excitation{.torque_Nm = run.torque_Nm}, noise_);
    return result;
  }

  NoiseLevels noise_;
  std::optional<RobustTarget> target_;
  std::vector<Contributions> beside_;
};

RobustEvaluation evaluate_reference(const Reference& reference, const ClosedLoop& loop,
                                    std::span<const BrakeParameters> brakes, const RunScore& score) {
  RobustEvaluation result;
  result.torque_max_Nm = result.force_max_N = result.stop_force_max_N = result.velocity_max_rad_s = 0.0;
  double squares_N2 = 0.0;
  TrackedRun run;
  for (std::size_t i = 0; i < brakes.size(); ++i) {
    loop.track(reference, brakes[i], run);
    const double unbounded = run.bounded ? 0.0 : kInfinity;
    result.torque_max_Nm = std::max(result.torque_max_Nm, run.torque_max_Nm);
    result.force_max_N = std::max({result.force_max_N, run.force_max_N, unbounded});
    result.stop_force_max_N = std::max({result.stop_force_max_N, run.stop_force_max_N, unbounded});
    result.velocity_max_rad_s = std::max({result.velocity_max_rad_s, run.velocity_max_rad_s, unbounded});
    squares_N2 += run.tracking_rms_N * run.tracking_rms_N;
    result.logdet.push_back(run.bounded ? score(i, brakes[i], run) : kInfinity);
  }
  const auto count = static_cast<double>(brakes.size());
  result.tracking_rms_N = std::sqrt(squares_N2 / count);
  result.expected_logdet = std::accumulate(result.logdet.begin(), result.logdet.end(), 0.0) / count;
  std::vector<double> sorted = result.logdet;
  std::sort(sorted.begin(), sorted.end());
  result.worst_decile_logdet = sorted[std::min(sorted.size() - 1, sorted.size() * 9 / 10)];
  return result;
}

/// Brakes at the ends of the prior, where the limits are met first: every corner of the stiffness, with all
/// of the friction at one end or the other.
std::vector<BrakeParameters> extreme_brakes(const BrakeParameters& nominal) {
  std::vector<BrakeParameters> brakes(8, nominal);
  for (std::size_t corner = 0; corner < brakes.size(); ++corner)
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const std::size_t bit = std::min<std::size_t>(i, 2);  // k1, k2, the rest
      const double share = (corner >> bit & 1) != 0 ? 1.0 + kBeyondTableII : -kBeyondTableII;
      brakes[corner].theta[static_cast<Eigen::Index>(i)] *= std::pow(kTableII[i], share);
    }
  return brakes;
}

/// The robust design as a nonlinear programme over the torques of the blocks, in units of the torque limit.
/// Constraints, each c <= 0: force and speed of the worst brake, force, speed and speed at the
/// end of the nominal one.
class RobustProblem {
 public:
  static constexpr std::size_t kConstraints = 5;

  struct Value {
    double objective = kUnidentified;
    std::array<double, kConstraints> constraint{};
    double violation() const {
      return std::max(0.0, *std::max_element(constraint.begin(), constraint.end()));
    }
  };

  RobustProblem(const RobustOptions& options, std::span<const BrakeParameters> brakes)
      : options_(options),
        brakes_(brakes),
        extremes_(extreme_brakes(options.nominal)),
        loop_(nominal_drive(options.nominal), options.limits.torque_Nm),
        score_(options.noise, options.target, loop_, options.nominal, brakes) {}

  Value evaluate(std::span<const double> x) {
    ++evaluations_;
    std::vector<double> block_torque_Nm(x.begin(), x.end());
    for (double& torque : block_torque_Nm) torque *= options_.limits.torque_Nm;
    const Run run = response_to(block_torque_Nm, options_.block_samples, options_.nominal);
    const DesignLimits& limits = options_.limits;
    Value value;
    value.constraint.fill(10.0);
    if (run.size() != options_.samples || !std::isfinite(run.position_rad.back())) return value;
    const double force_N = *std::max_element(run.force_N.begin(), run.force_N.end());
    double speed_rad_s = 0.0;
    for (const double velocity : run.velocity_rad_s) speed_rad_s = std::max(speed_rad_s, std::abs(velocity));
    const Result<Reference> reference = build_reference(run, options_.nominal, kOpen);
    if (!reference) return value;
    const RobustEvaluation evaluation = evaluate_reference(*reference, loop_, brakes_, score_);
    double worst_force_N = evaluation.force_max_N;
    double worst_speed_rad_s = evaluation.velocity_max_rad_s;
    TrackedRun tracked;
    for (const BrakeParameters& brake : extremes_) {
      loop_.track(*reference, brake, tracked);
      if (!tracked.bounded) return value;
      worst_force_N = std::max(worst_force_N, tracked.force_max_N);
      worst_speed_rad_s = std::max(worst_speed_rad_s, tracked.velocity_max_rad_s);
    }
    const auto over = [](double worst, double limit) {
      return std::min(10.0, worst / (limit * (1.0 - kTightening)) - 1.0);
    };
    value.constraint[0] = over(worst_force_N, limits.force_N);
    value.constraint[1] = over(worst_speed_rad_s, limits.velocity_rad_s);
    value.constraint[2] = over(force_N, limits.force_N);
    value.constraint[3] = over(speed_rad_s, limits.velocity_rad_s);
    value.constraint[4] =
        (std::abs(run.velocity_rad_s.back()) - limits.end_velocity_rad_s) / limits.velocity_rad_s;
    if (std::isfinite(evaluation.expected_logdet)) value.objective = evaluation.expected_logdet;
    return value;
  }

  /// `gradient`: 1 + kConstraints rows of x.size() forward differences.
  void differentiate(std::span<const double> x, const Value& here, std::vector<double>& gradient) {
    gradient.assign((1 + kConstraints) * x.size(), 0.0);
    std::vector<double> moved(x.begin(), x.end());
    for (std::size_t block = 0; block < x.size(); ++block) {
      moved[block] = x[block] + (x[block] > 0.0 ? -kDifferenceStep : kDifferenceStep);
      const double taken = moved[block] - x[block];
      const Value value = evaluate(moved);
      moved[block] = x[block];
      gradient[block] = (value.objective - here.objective) / taken;
      for (std::size_t row = 0; row < kConstraints; ++row)
        gradient[(1 + row) * x.size() + block] = (value.constraint[row] - here.constraint[row]) / taken;
    }
  }

  std::int64_t evaluations() const { return evaluations_; }

 private:
  const RobustOptions& options_;
  std::span<const BrakeParameters> brakes_;
  std::vector<BrakeParameters> extremes_;
  ClosedLoop loop_;
  RunScore score_;
  std::int64_t evaluations_ = 0;
};

struct Candidate {
  std::vector<double> x;
  double objective = kInfinity;  ///< infinite: not within the limits
};

/// One local search: what NLopt asks for in turn, computed once per point.
struct LocalSearch {
  RobustProblem& problem;
  Candidate& best;
  std::vector<double> point;
  RobustProblem::Value value;
  bool differentiated = false;
  std::vector<double> gradient;

  void at(std::span<const double> x, bool with_gradient) {
    if (!std::equal(x.begin(), x.end(), point.begin(), point.end())) {
      point.assign(x.begin(), x.end());
      value = problem.evaluate(x);
      differentiated = false;
      if (value.violation() <= kFeasible && value.objective < std::min(best.objective, kUnidentified))
        best = {point, value.objective};
    }
    if (with_gradient && !differentiated) {
      problem.differentiate(x, value, gradient);
      differentiated = true;
    }
  }
};

double objective_for_search(unsigned count, const double* x, double* gradient, void* data) {
  auto& search = *static_cast<LocalSearch*>(data);
  search.at({x, count}, gradient != nullptr);
  if (gradient != nullptr) std::copy_n(search.gradient.begin(), count, gradient);
  return search.value.objective;
}

void constraints_for_search(unsigned, double* result, unsigned count, const double* x, double* gradient,
                            void* data) {
  auto& search = *static_cast<LocalSearch*>(data);
  search.at({x, count}, gradient != nullptr);
  if (gradient != nullptr) std::copy(search.gradient.begin() + count, search.gradient.end(), gradient);
  std::copy(search.value.constraint.begin(), search.value.constraint.end(), result);
}

struct OptimiserDeleter {
  void operator()(nlopt_opt optimiser) const { nlopt_destroy(optimiser); }
};
using Optimiser = std::unique_ptr<std::remove_pointer_t<nlopt_opt>, OptimiserDeleter>;

/// Sequential quadratic programming from `x`; the best feasible point that it passes.
Candidate search_from(RobustProblem& problem, std::vector<double> x, int evaluations) {
  Candidate best;
  LocalSearch search{problem, best, {}, {}, false, {}};
  const Optimiser optimiser(nlopt_create(NLOPT_LD_SLSQP, static_cast<unsigned>(x.size())));
  const std::array<double, RobustProblem::kConstraints> tolerance = [] {
    std::array<double, RobustProblem::kConstraints> values{};
    values.fill(kFeasible);
    return values;
  }();
  nlopt_set_min_objective(optimiser.get(), objective_for_search, &search);
  nlopt_add_inequality_mconstraint(optimiser.get(), RobustProblem::kConstraints, constraints_for_search,
                                   &search, tolerance.data());
  nlopt_set_lower_bounds1(optimiser.get(), -kNominalTorque);
  nlopt_set_upper_bounds1(optimiser.get(), kNominalTorque);
  nlopt_set_ftol_abs(optimiser.get(), 1e-3);
  nlopt_set_maxeval(optimiser.get(), evaluations);
  for (double& share : x) share = std::clamp(share, -kNominalTorque, kNominalTorque);
  double reached = kInfinity;
  // Failures of its line search near a kink of the model are an end like any other.
  nlopt_optimize(optimiser.get(), x.data(), &reached);
  return best;
}

/// A D-optimal design with room for the loop: a starting point.
std::vector<double> cautious_design(const RobustOptions& options, std::uint64_t seed) {
  std::seed_seq sequence{options.seed, options.seed >> 32, seed, std::uint64_t{1}};
  std::mt19937_64 random(sequence);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  DesignOptions design;
  design.brake = options.nominal;
  design.samples = options.samples;
  design.block_samples = options.block_samples;
  design.noise = options.noise.sensors;
  design.limits = options.limits;
  design.limits.torque_Nm *= 0.6 + 0.3 * unit(random);
  design.limits.force_N *= 0.75 + 0.25 * unit(random);
  design.limits.velocity_rad_s *= 0.7 + 0.15 * unit(random);
  design.caution = 3.0;
  design.seed = random();
  design.starts = kSeedingStarts;
  design.threads = 1;
  std::vector<double> x = design_experiment(design).block_torque_Nm;
  for (double& torque : x) torque /= options.limits.torque_Nm;
  return x;
}

/// The known design as a start, whatever the length and the blocks: its torque at the middle of each block.
std::vector<double> known_design(const RobustOptions& options) {
  std::vector<double> x(options.samples / options.block_samples);
  for (std::size_t block = 0; block < x.size(); ++block) {
    const std::size_t known = (2 * block + 1) * options.block_samples / (2 * kKnownRobustBlockSamples);
    x[block] =
        kKnownRobustBlocks_Nm[std::min(known, kKnownRobustBlocks_Nm.size() - 1)] / options.limits.torque_Nm;
  }
  return x;
}

std::vector<double> variation(const std::vector<Candidate>& elite, std::mt19937_64& random) {
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> normal;
  const auto below = [&](std::size_t count, double draw) {
    return std::min(count - 1, static_cast<std::size_t>(draw * static_cast<double>(count)));
  };
  std::vector<double> x = elite[below(elite.size(), unit(random) * unit(random))].x;
  const double kind = unit(random);
  if (kind < 0.5) {
    const double size = std::pow(10.0, -1.7 + 1.0 * unit(random));
    for (double& share : x) share += size * normal(random);
  } else if (kind < 0.75) {  // one design's beginning, another's end
    const std::vector<double>& other = elite[below(elite.size(), unit(random))].x;
    const auto from = static_cast<std::ptrdiff_t>(below(x.size(), unit(random)));
    std::copy(other.begin() + from, other.end(), x.begin() + from);
    for (double& share : x) share += 0.03 * normal(random);
  } else {
    x[below(x.size(), unit(random))] += 0.3 * normal(random);
    x[below(x.size(), unit(random))] += 0.3 * normal(random);
  }
  return x;
}

}  // namespace

std::vector<BrakeParameters> draw_prior(const BrakeParameters& nominal, std::size_t count,
                                        std::uint64_t seed) {
  std::seed_seq sequence{seed, seed >> 32, std::uint64_t{2}};
  std::mt19937_64 random(sequence);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::vector<BrakeParameters> brakes(count, nominal);
  std::vector<std::size_t> order(count);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::shuffle(order.begin(), order.end(), random);
    for (std::size_t k = 0; k < count; ++k) {
      const double share = (static_cast<double>(order[k]) + unit(random)) / static_cast<double>(count);
      brakes[k].theta[static_cast<Eigen::Index>(i)] *=
          std::pow(kTableII[i], (1.0 + 2.0 * kBeyondTableII) * share - kBeyondTableII);
    }
  }
  return brakes;
}

Result<void> RobustOptions::validate() const {
  DesignOptions design;
  design.brake = nominal;
  design.samples = samples;
  design.block_samples = block_samples;
  design.limits = limits;
  design.noise = noise.sensors;
  design.starts = starts;
  design.threads = threads;
  if (const Result<void> valid = design.validate(); !valid) return valid;
  if (!(noise.torque_Nm >= 0.0 && std::isfinite(noise.torque_Nm)))
    return failure("the noise of the torque must not be negative");
  if (target) {
    if (target->parameters.empty() || !(target->runs > 0.0))
      return failure("a design for some parameters needs one of them, and runs to be driven beside");
    if (const auto beside = build_reference(target->beside, nominal); !beside) return tl::unexpected(beside.error());
  }
  if (search_brakes < 2 || search_brakes > 10000 || verify_brakes < 10 || verify_brakes > 100000)
    return failure("the prior needs 2 to 10000 brakes for the search and 10 to 100000 to verify");
  return {};
}

Result<RobustEvaluation> evaluate_robust(const Run& trajectory, const BrakeParameters& nominal,
                                         std::span<const BrakeParameters> brakes, const NoiseLevels& noise,
                                         double torque_limit_Nm, const std::optional<RobustTarget>& target) {
  CLAMPD_ASSERT(!brakes.empty());
  const Result<Reference> reference = build_reference(trajectory, nominal);
  if (!reference) return tl::unexpected(reference.error());
  const ClosedLoop loop(nominal_drive(nominal), torque_limit_Nm);
  return evaluate_reference(*reference, loop, brakes, RunScore(noise, target, loop, nominal, brakes));
}

RobustGain gain_over(const RobustEvaluation& baseline, const RobustEvaluation& design,
                     const std::optional<RobustTarget>& target) {
  const double parameters = target ? 1.0 : static_cast<double>(kParameterCount);
  return {std::exp((baseline.expected_logdet - design.expected_logdet) / parameters),
          std::exp((baseline.worst_decile_logdet - design.worst_decile_logdet) / parameters)};
}

Result<PlainStep> best_step(const RobustOptions& options, std::span<const BrakeParameters> brakes) {
  const double length_s = static_cast<double>(options.samples) * kPeriod_s;
  const ClosedLoop loop(nominal_drive(options.nominal), options.limits.torque_Nm);
  const RunScore score(options.noise, std::nullopt, loop, options.nominal, brakes);
  const auto keeps_limits = [&](const Reference& reference) {
    TrackedRun tracked;
    return std::all_of(brakes.begin(), brakes.end(), [&](const BrakeParameters& brake) {
      loop.track(reference, brake, tracked);
      return tracked.bounded && tracked.torque_max_Nm <= options.limits.torque_Nm &&
             tracked.force_max_N <= options.limits.force_N &&
             tracked.velocity_max_rad_s <= options.limits.velocity_rad_s;
    });
  };
  PlainStep best;
  double best_logdet = kInfinity;
  for (double force_N = kStepLevel_N; force_N < options.limits.force_N; force_N += kStepLevel_N) {
    for (double rise_s = kStepRise_s; rise_s <= (1.0 - kLeastHold) * length_s + 1e-9; rise_s += kStepRise_s) {
      const std::array<ManoeuvreSegment, 2> segments = {
          ManoeuvreSegment{.duration_s = rise_s, .force_N = force_N},
          ManoeuvreSegment{.duration_s = length_s - rise_s, .force_N = force_N}};
      Result<Run> run = follow_segments("step", segments, options.nominal);
      if (!run) continue;
      for (auto* column :
           {&run->time_s, &run->torque_Nm, &run->velocity_rad_s, &run->force_N, &run->position_rad})
        column->resize(options.samples);
      const Result<Reference> reference = build_reference(*run, options.nominal);
      if (!reference || !keeps_limits(*reference)) continue;
      const RobustEvaluation evaluation = evaluate_reference(*reference, loop, brakes, score);
      if (evaluation.expected_logdet < best_logdet) {
        best_logdet = evaluation.expected_logdet;
        best = {force_N, rise_s, std::move(*run)};
      }
      break;  // a slower rise to the same force is no longer a step
    }
  }
  if (!std::isfinite(best_logdet)) return failure("no step of the clamp force keeps the limits");
  return best;
}

Run response_to(const std::vector<double>& block_torque_Nm, std::size_t block_samples,
                const BrakeParameters& brake, const BrakeState& initial) {
  Run run;
  run.name = "design";
  run.torque_Nm = expand_blocks(block_torque_Nm, block_samples);
  Simulation simulation(run.torque_Nm.size());
  simulate(brake, initial, Excitation{.torque_Nm = run.torque_Nm}, simulation);
  run.time_s.reserve(run.torque_Nm.size());
  for (std::size_t k = 0; k < run.torque_Nm.size(); ++k)
    run.time_s.push_back(static_cast<double>(k) / 1000.0);
  run.velocity_rad_s = std::move(simulation.velocity_rad_s);
  run.force_N = std::move(simulation.force_N);
  run.position_rad = std::move(simulation.position_rad);
  return run;
}

namespace {

/// Searches from cautious starts, then from variations of the best, then polishes two. The best first.
std::vector<Candidate> search_experiments(const RobustOptions& options, RobustSummary& summary) {
  const int threads = threads_or_all(options.threads);
  const std::vector<BrakeParameters> brakes =
      draw_prior(options.nominal, options.search_brakes, options.seed);
  std::vector<RobustProblem> problems(static_cast<std::size_t>(threads), RobustProblem(options, brakes));
  std::vector<Candidate> found;
  std::vector<Candidate> elite;
  const auto total = static_cast<std::size_t>(options.starts);
  std::size_t done = 0;
  const auto round = [&](std::size_t count, const auto& task) {
    std::vector<Candidate> candidates(count);
    for_each_index(count, threads, [&](std::size_t thread, std::size_t i) {
      // Each task draws from its own stream, so that no result depends on which thread does it.
      std::seed_seq sequence{options.seed, options.seed >> 32, static_cast<std::uint64_t>(done + i)};
      std::mt19937_64 random(sequence);
      candidates[i] = task(problems[thread], random, i);
    });
    done += count;
    for (Candidate& candidate : candidates)
      if (std::isfinite(candidate.objective)) found.push_back(std::move(candidate));
    std::stable_sort(found.begin(), found.end(),
                     [](const Candidate& a, const Candidate& b) { return a.objective < b.objective; });
    elite.assign(found.begin(), found.begin() + static_cast<std::ptrdiff_t>(std::min(kElite, found.size())));
    if (options.progress)
      options.progress(std::min(1.0, static_cast<double>(done) / static_cast<double>(total + 2)),
                       found.empty() ? kInfinity : found.front().objective);
  };
  while (done < total) {
    const std::size_t count = std::min(kRoundStarts, total - done);
    const std::size_t first = done;
    if (done < total / 3 || elite.empty())
      round(count, [&](RobustProblem& problem, std::mt19937_64&, std::size_t i) {
        std::vector<double> x = first + i == 0 ? known_design(options) : cautious_design(options, first + i);
        return x.empty() ? Candidate{} : search_from(problem, std::move(x), kExplorationEvaluations);
      });
    else
      round(count, [&](RobustProblem& problem, std::mt19937_64& random, std::size_t) {
        return search_from(problem, variation(elite, random), kImprovementEvaluations);
      });
  }
  const std::vector<Candidate> rough(
      elite.begin(), elite.begin() + static_cast<std::ptrdiff_t>(std::min<std::size_t>(2, elite.size())));
  round(rough.size(), [&](RobustProblem& problem, std::mt19937_64&, std::size_t i) {
    const Candidate polished = search_from(problem, rough[i].x, kPolishEvaluations);
    return polished.objective < rough[i].objective ? polished : rough[i];
  });
  for (const RobustProblem& problem : problems) summary.evaluations += problem.evaluations();
  return elite;
}

/// Takes the best candidate that keeps the limits for brakes that the search did not see.
void take_first_that_holds(const RobustOptions& options, std::span<const Candidate> candidates,
                           std::span<const BrakeParameters> others, RobustSummary& summary) {
  summary.message =
      "of the designs found none keeps the limits for the brakes that verify it; try more "
      "brakes for the search";
  for (const Candidate& candidate : candidates) {
    std::vector<double> block_torque_Nm = candidate.x;
    for (double& torque : block_torque_Nm) torque *= options.limits.torque_Nm;
    Run trajectory = response_to(block_torque_Nm, options.block_samples, options.nominal);
    Result<RobustEvaluation> evaluation = evaluate_robust(trajectory, options.nominal, others, options.noise,
                                                          options.limits.torque_Nm, options.target);
    if (!evaluation || !std::isfinite(evaluation->expected_logdet) ||
        evaluation->force_max_N > options.limits.force_N ||
        evaluation->velocity_max_rad_s > options.limits.velocity_rad_s)
      continue;
    summary.found = true;
    summary.message =
        fmt::format("keeps the limits for {} brakes that the search did not see", others.size());
    summary.block_torque_Nm = std::move(block_torque_Nm);
    summary.trajectory = std::move(trajectory);
    summary.evaluation = std::move(*evaluation);
    summary.gain = gain_over(summary.step_evaluation, summary.evaluation, options.target);
    DesignOptions design;
    design.brake = options.nominal;
    design.samples = options.samples;
    design.block_samples = options.block_samples;
    design.noise = options.noise.sensors;
    summary.nominal = evaluate_design(design, summary.block_torque_Nm);
    return;
  }
}

}  // namespace

RobustSummary design_robust_experiment(const RobustOptions& options) {
  CLAMPD_ASSERT(options.validate());
  const auto begin = std::chrono::steady_clock::now();
  RobustSummary summary;
  const std::vector<Candidate> found = search_experiments(options, summary);
  const std::vector<BrakeParameters> others =
      draw_prior(options.nominal, options.verify_brakes, ~options.seed);
  const Result<PlainStep> baseline =
      options.target ? PlainStep{0.0, 0.0, options.target->beside} : best_step(options, others);
  if (!baseline) {
    summary.message = baseline.error().message;
  } else if (found.empty()) {
    summary.message = "no start found an experiment that keeps the limits for all brakes of the prior";
  } else {
    if (!options.target) summary.step = *baseline;
    summary.step_evaluation = *evaluate_robust(baseline->trajectory, options.nominal, others, options.noise,
                                               options.limits.torque_Nm, options.target);
    take_first_that_holds(options, found, others, summary);
  }
  if (options.progress && summary.found) options.progress(1.0, summary.evaluation.expected_logdet);
  summary.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return summary;
}

}  // namespace clampd
