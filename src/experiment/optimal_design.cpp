#include "clampd/experiment/optimal_design.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <random>
#include <span>

#include <fmt/format.h>
#include <nlopt.h>

#include "clampd/base/assert.hpp"
#include "clampd/base/parallel.hpp"
#include "design_problem.hpp"

namespace clampd {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Share by which the search undercuts the limits on force and speed: room for what happens between the
/// samples and for the difference of the integrators.
constexpr double kTightening = 2e-4;
/// A violation that counts as none, relative to a limit: well inside of the tightening.
constexpr double kFeasible = 2e-5;

constexpr std::size_t kExploration = 64;        ///< fewest starts of the exploration
constexpr std::size_t kRandomExperiments = 60;  ///< tried for each start of the exploration
constexpr std::size_t kVariations = 30;         ///< tried for each start of the improvement
constexpr int kExplorationEvaluations = 60;
constexpr int kImprovementEvaluations = 60;
constexpr int kPolishEvaluations = 300;
constexpr std::size_t kElite = 16;
constexpr std::size_t kRoundStarts = 24;  ///< starts between two selections of the elite
/// Designs whose torques are nowhere further apart than this share of the limit are of one family; the elite
/// holds one of each.
constexpr double kSameFamily = 0.1;
/// The same of designs that certify() would refuse for the same reason.
constexpr double kSameDesign = 0.003;
/// A start this close to its parent in the objective would only be searched again.
constexpr double kSameObjective = 0.02;
/// What a design that is not steady counts worse by.
constexpr double kUnsteady = 0.5;
/// Points of a local search closer to one that is not steady are not tested again.
constexpr double kWorthTesting = 0.01;
/// Designs that are shown to certify() before the search gives up.
constexpr std::size_t kCertifications = 30;

struct CandidateDesign {
  std::vector<double> x;  ///< torques of the blocks over the torque limit
  double objective = kInfinity;
  bool steady = false;

  /// What candidates are compared by: unsteady ones make good parents, but no good designs.
  double rank() const { return steady ? objective : objective + kUnsteady; }
};

struct OptimiserDeleter {
  void operator()(nlopt_opt optimiser) const { nlopt_destroy(optimiser); }
};
using Optimiser = std::unique_ptr<std::remove_pointer_t<nlopt_opt>, OptimiserDeleter>;

/// What the search is told where M is singular: worse than any real design, and finite, as it must be.
constexpr double kSingularObjective = 1e3;

/// A local search: its problem and the feasible points that it passes.
struct Passage {
  DesignProblem& problem;
  std::vector<CandidateDesign> feasible;
};

double objective_for_search(unsigned count, const double* x, double* gradient, void* data) {
  auto& passage = *static_cast<Passage*>(data);
  DesignProblem& problem = passage.problem;
  if (gradient != nullptr) {
    problem.differentiate({x, count});
    std::copy(problem.objective_gradient().begin(), problem.objective_gradient().end(), gradient);
  } else {
    problem.evaluate({x, count});
  }
  if (!std::isfinite(problem.objective())) return kSingularObjective;
  if (problem.violation() <= kFeasible)
    passage.feasible.push_back({std::vector<double>(x, x + count), problem.objective()});
  return problem.objective();
}

void constraints_for_search(unsigned constraints, double* result, unsigned count, const double* x,
                            double* gradient, void* data) {
  DesignProblem& problem = static_cast<Passage*>(data)->problem;
  if (gradient != nullptr) {
    problem.differentiate({x, count});
    for (unsigned row = 0; row < constraints; ++row)
      for (unsigned column = 0; column < count; ++column)
        gradient[row * count + column] = problem.constraint_gradient()(row, column);
  } else {
    problem.evaluate({x, count});
  }
  std::copy(problem.constraint_values().begin(), problem.constraint_values().end(), result);
}

/// Sequential quadratic programming from candidate.x; keeps the best steady one of the feasible points
/// that it passes: where it ends is often the verge of a lock-up.
void improve(DesignProblem& problem, CandidateDesign& candidate, int evaluations) {
  const auto count = static_cast<unsigned>(problem.blocks());
  const Optimiser optimiser(nlopt_create(NLOPT_LD_SLSQP, count));
  const std::vector<double> tolerance(problem.constraints(), kFeasible);
  Passage passage{problem, {}};
  nlopt_set_min_objective(optimiser.get(), objective_for_search, &passage);
  nlopt_add_inequality_mconstraint(optimiser.get(), static_cast<unsigned>(problem.constraints()),
                                   constraints_for_search, &passage, tolerance.data());
  nlopt_set_lower_bounds1(optimiser.get(), -1.0);
  nlopt_set_upper_bounds1(optimiser.get(), 1.0);
  nlopt_set_ftol_abs(optimiser.get(), 1e-4);
  nlopt_set_maxeval(optimiser.get(), evaluations);
  std::vector<double> x = candidate.x;
  double reached = kInfinity;
  // Failures of its line search near a kink of the model are an end like any other.
  nlopt_optimize(optimiser.get(), x.data(), &reached);
  std::vector<CandidateDesign>& feasible = passage.feasible;
  std::stable_sort(feasible.begin(), feasible.end(), [](const CandidateDesign& a, const CandidateDesign& b) {
    return a.objective < b.objective;
  });
  if (feasible.empty() || !(feasible.front().objective < candidate.rank())) return;
  double tested = -kInfinity;
  for (CandidateDesign& passed : feasible) {
    if (passed.objective >= std::min(candidate.rank(), feasible.front().rank())) break;
    if (passed.objective < tested + kWorthTesting) continue;
    tested = passed.objective;
    passed.steady = problem.is_steady(passed.x);
    if (!passed.steady) continue;
    candidate = passed;
    return;
  }
  if (feasible.front().rank() < candidate.rank()) candidate = feasible.front();
}

/// Objective with the violation added: ranks starts, feasible or not.
double merit(DesignProblem& problem, std::span<const double> x) {
  problem.evaluate(x);
  return problem.objective() + 100.0 * problem.violation();
}

bool alike(const CandidateDesign& a, const CandidateDesign& b, double distance) {
  return std::equal(a.x.begin(), a.x.end(), b.x.begin(),
                    [distance](double one, double other) { return std::abs(one - other) <= distance; });
}

class DesignSearch {
 public:
  explicit DesignSearch(const DesignOptions& options);
  void run();
  /// All feasible designs found: the steady ones, then the others, each the best one first.
  const std::vector<CandidateDesign>& feasible() const { return feasible_; }
  std::int64_t simulations() const;

 private:
  CandidateDesign explore(DesignProblem& problem, std::mt19937_64& random) const;
  CandidateDesign vary(DesignProblem& problem, std::mt19937_64& random) const;
  void vary_once(DesignProblem& problem, std::mt19937_64& random, std::vector<double>& x) const;
  template <class Task>
  std::vector<CandidateDesign> in_parallel(std::size_t count, const Task& task);
  void select(std::vector<CandidateDesign>&& found);
  void report(bool done) const;

  const DesignOptions& options_;
  std::vector<DesignProblem> problems_;
  std::vector<CandidateDesign> feasible_;
  std::vector<CandidateDesign> elite_;
  std::uint64_t task_ = 0;
  std::size_t total_;
};

DesignSearch::DesignSearch(const DesignOptions& options)
    : options_(options), total_(static_cast<std::size_t>(options.starts)) {
  for (int i = 0; i < threads_or_all(options.threads); ++i) problems_.emplace_back(options, kTightening);
}

std::int64_t DesignSearch::simulations() const {
  std::int64_t sum = 0;
  for (const DesignProblem& problem : problems_) sum += problem.simulations();
  return sum;
}

template <class Task>
std::vector<CandidateDesign> DesignSearch::in_parallel(std::size_t count, const Task& task) {
  std::vector<CandidateDesign> found(count);
  for_each_index(count, static_cast<int>(problems_.size()), [&](std::size_t thread, std::size_t i) {
    // Each task draws from its own stream, so that no result depends on which thread does it.
    std::seed_seq seed{options_.seed, options_.seed >> 32, task_ + i};
    std::mt19937_64 random(seed);
    problems_[thread].forget();
    found[i] = task(problems_[thread], random, i);
  });
  task_ += count;
  return found;
}

CandidateDesign DesignSearch::explore(DesignProblem& problem, std::mt19937_64& random) const {
  CandidateDesign best{std::vector<double>(problem.blocks()), kInfinity};
  double best_merit = kInfinity;
  std::vector<double> x(problem.blocks());
  for (std::size_t i = 0; i < kRandomExperiments; ++i) {
    problem.random_tail(random, 0, x);
    const double value = merit(problem, x);
    if (i > 0 && !(value < best_merit)) continue;
    best_merit = value;
    best.x = x;
  }
  improve(problem, best, kExplorationEvaluations);
  return best;
}

void DesignSearch::vary_once(DesignProblem& problem, std::mt19937_64& random, std::vector<double>& x) const {
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> normal;
  const auto block = [&] {
    return std::min(x.size() - 1, static_cast<std::size_t>(unit(random) * static_cast<double>(x.size())));
  };
  const double kind = unit(random);
  if (kind < 0.25) {
    problem.random_tail(random, block(), x);
  } else if (kind < 0.5) {
    const double size = std::pow(10.0, -2.0 + 1.7 * unit(random));
    for (double& share : x) share += size * normal(random);
  } else if (kind < 0.7) {  // move what comes later by a block
    const auto from = static_cast<std::ptrdiff_t>(block());
    if (unit(random) < 0.5)
      std::rotate(x.begin() + from, x.end() - 1, x.end());
    else
      std::rotate(x.begin() + from, x.begin() + from + 1, x.end());
  } else if (kind < 0.85) {  // one design's beginning, another's end
    const auto& other =
        elite_[std::min(elite_.size() - 1,
                        static_cast<std::size_t>(unit(random) * static_cast<double>(elite_.size())))]
            .x;
    const auto from = static_cast<std::ptrdiff_t>(block());
    std::copy(other.begin() + from, other.end(), x.begin() + from);
  } else {
    x[block()] = 2.0 * unit(random) - 1.0;
    x[block()] += 0.3 * normal(random);
  }
  for (double& share : x) share = std::clamp(share, -1.0, 1.0);
}

CandidateDesign DesignSearch::vary(DesignProblem& problem, std::mt19937_64& random) const {
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  // The better ones more often.
  const double draw = unit(random) * unit(random);
  const std::size_t index =
      std::min(elite_.size() - 1, static_cast<std::size_t>(draw * static_cast<double>(elite_.size())));
  const CandidateDesign& parent = elite_[index];
  CandidateDesign best{parent.x, kInfinity};
  double best_merit = kInfinity;
  for (std::size_t i = 0; i < kVariations; ++i) {
    std::vector<double> x = parent.x;
    vary_once(problem, random, x);
    const double value = merit(problem, x);
    if (std::abs(value - parent.objective) < kSameObjective) continue;
    if (!(value < best_merit)) continue;
    best_merit = value;
    best.x = std::move(x);
  }
  improve(problem, best, kImprovementEvaluations);
  return best;
}

void DesignSearch::select(std::vector<CandidateDesign>&& found) {
  for (CandidateDesign& candidate : found)
    if (std::isfinite(candidate.objective)) feasible_.push_back(std::move(candidate));
  std::stable_sort(feasible_.begin(), feasible_.end(),
                   [](const CandidateDesign& a, const CandidateDesign& b) { return a.rank() < b.rank(); });
  elite_.clear();
  for (const CandidateDesign& candidate : feasible_) {
    if (elite_.size() == kElite) break;
    if (std::none_of(elite_.begin(), elite_.end(),
                     [&](const CandidateDesign& better) { return alike(better, candidate, kSameFamily); }))
      elite_.push_back(candidate);
  }
}

void DesignSearch::report(bool done) const {
  if (!options_.progress) return;
  // The polish at the end has at most kElite tasks.
  options_.progress(done ? 1.0 : static_cast<double>(task_) / static_cast<double>(total_ + kElite),
                    elite_.empty() ? kInfinity : elite_.front().objective);
}

void DesignSearch::run() {
  const std::size_t exploration = std::min(total_, std::max(kExploration, total_ / 5));
  while (task_ < total_) {
    const std::size_t count = std::min(kRoundStarts, total_ - static_cast<std::size_t>(task_));
    if (task_ < exploration || elite_.empty())
      select(in_parallel(
          count, [this](auto& problem, auto& random, std::size_t) { return explore(problem, random); }));
    else
      select(in_parallel(count,
                         [this](auto& problem, auto& random, std::size_t) { return vary(problem, random); }));
    report(false);
  }
  const std::vector<CandidateDesign> rough = elite_;
  select(in_parallel(rough.size(), [&rough](DesignProblem& problem, std::mt19937_64&, std::size_t i) {
    CandidateDesign candidate = rough[i];
    improve(problem, candidate, kPolishEvaluations);
    return candidate;
  }));
  std::stable_partition(feasible_.begin(), feasible_.end(),
                        [](const CandidateDesign& candidate) { return candidate.steady; });
  report(true);
}

}  // namespace

std::vector<double> expand_blocks(const std::vector<double>& block_torque_Nm, std::size_t block_samples) {
  std::vector<double> torque_Nm;
  torque_Nm.reserve(block_torque_Nm.size() * block_samples);
  for (const double torque : block_torque_Nm) torque_Nm.insert(torque_Nm.end(), block_samples, torque);
  return torque_Nm;
}

DesignEvaluation evaluate_design(const DesignOptions& options, std::span<const double> block_torque_Nm) {
  CLAMPD_ASSERT(block_torque_Nm.size() * options.block_samples == options.samples);
  const std::vector<double> torque_Nm =
      expand_blocks({block_torque_Nm.begin(), block_torque_Nm.end()}, options.block_samples);
  SensitivitySimulation run(torque_Nm.size());
  simulate(options.brake, options.initial, Excitation{.torque_Nm = torque_Nm}, run);
  DesignEvaluation evaluation;
  if (!run.complete()) return evaluation;
  const auto largest = [](const std::vector<double>& values) {
    double result = 0.0;
    for (const double value : values) result = std::max(result, std::abs(value));
    return result;
  };
  evaluation.criterion = criterion_of(initial_state_known(joint_information(run, options.noise)));
  evaluation.force_max_N = largest(run.force_N);
  evaluation.velocity_max_rad_s = largest(run.velocity_rad_s);
  const DesignLimits& limits = options.limits;
  evaluation.violation = std::max(
      {0.0, largest(torque_Nm) / limits.torque_Nm - 1.0, evaluation.force_max_N / limits.force_N - 1.0,
       evaluation.velocity_max_rad_s / limits.velocity_rad_s - 1.0,
       (std::abs(run.velocity_rad_s.back()) - limits.end_velocity_rad_s) / limits.velocity_rad_s});
  return evaluation;
}

std::string_view to_string(DesignTermination termination) noexcept {
  switch (termination) {
    case DesignTermination::Certified:
      return "certified";
    case DesignTermination::NothingFeasible:
      return "nothing feasible";
    case DesignTermination::NotCertified:
      return "not certified";
  }
  return "unknown";
}

Result<void> DesignOptions::validate() const {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0.0; };
  if (block_samples < 1) return failure("a block needs at least one sample");
  if (samples < kFewestSamples || samples > kMaxSamples)
    return failure(fmt::format("an experiment of {} samples is not possible; {} to {} are", samples,
                               kFewestSamples, kMaxSamples));
  if (samples % block_samples != 0)
    return failure(
        fmt::format("{} samples are not a whole number of blocks of {} samples", samples, block_samples));
  if (samples / block_samples > kMaxBlocks)
    return failure(fmt::format("{} blocks are too many to optimise; at most {}: take longer blocks",
                               samples / block_samples, kMaxBlocks));
  if (!positive(limits.torque_Nm)) return failure("the torque limit must be positive");
  if (!positive(limits.force_N)) return failure("the force limit must be positive");
  if (!positive(limits.velocity_rad_s)) return failure("the speed limit must be positive");
  if (!(limits.end_velocity_rad_s >= 0.0))
    return failure("the limit of the speed at the end must not be negative");
  if (!(limits.amplification_rad_s_Nm > 0.0)) return failure("the amplification limit must be positive");
  if (!positive(noise.force_N) || !positive(noise.velocity_rad_s))
    return failure("the noise of force and velocity must be positive");
  if (starts < 1 || starts > 1000000) return failure("the number of starts must be between 1 and 1000000");
  if (!(caution >= 0.0 && caution <= 1e3)) return failure("the caution must be between 0 and 1000");
  if (threads < 0) return failure("the number of threads must not be negative");
  if (!initial.allFinite() || !is_bounded(initial)) return failure("the initial state is not a possible one");
  if (std::abs(initial[1]) > limits.velocity_rad_s)
    return failure(fmt::format("the initial velocity of {} rad/s is beyond the speed limit of {}", initial[1],
                               limits.velocity_rad_s));
  if (const double force_N = paper_brake(brake).read(initial).force_N; force_N > limits.force_N)
    return failure(fmt::format("the clamp force at the initial position is {:.0f} N, beyond the limit of {}",
                               force_N, limits.force_N));
  return {};
}

DesignSummary design_experiment(const DesignOptions& options) {
  CLAMPD_ASSERT(options.validate());
  const auto begin = std::chrono::steady_clock::now();
  DesignSummary summary;
  DesignSearch search(options);
  search.run();
  summary.simulations = search.simulations();
  if (search.feasible().empty()) {
    summary.termination = DesignTermination::NothingFeasible;
    summary.message =
        "no start found an experiment that keeps the limits and identifies all parameters; allow more time, "
        "force or torque";
  }
  DesignProblem problem(options, 0.0);
  std::vector<const CandidateDesign*> refused;
  for (const CandidateDesign& candidate : search.feasible()) {
    if (refused.size() == kCertifications) break;
    if (std::any_of(refused.begin(), refused.end(),
                    [&](const CandidateDesign* other) { return alike(*other, candidate, kSameDesign); }))
      continue;
    problem.evaluate(candidate.x);
    std::vector<double> block_torque_Nm = candidate.x;
    for (double& torque : block_torque_Nm) torque *= options.limits.torque_Nm;
    const Criterion criterion = criterion_of(problem.information());
    Certification certification =
        certify(options.brake, options.initial, expand_blocks(block_torque_Nm, options.block_samples),
                options.noise, options.limits, criterion.logdet);
    if (!certification.granted()) {
      if (refused.empty()) {
        summary.termination = DesignTermination::NotCertified;
        summary.message = fmt::format(
            "an independent simulation refuses every design found; of the best one it says: {}. Try another "
            "seed or more starts",
            certification.objection);
      }
      refused.push_back(&candidate);
      continue;
    }
    summary.termination = DesignTermination::Certified;
    summary.message = refused.empty()
                          ? "certified by an independent simulation"
                          : fmt::format("certified by an independent simulation, which refused {} other{}",
                                        refused.size(), refused.size() == 1 ? "" : "s");
    summary.block_torque_Nm = std::move(block_torque_Nm);
    summary.criterion = criterion;
    summary.certification = std::move(certification);
    break;
  }
  summary.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return summary;
}

}  // namespace clampd
