#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/brake/simulation.hpp"
#include "clampd/experiment/certification.hpp"
#include "clampd/experiment/criterion.hpp"

namespace clampd {

/// Fewer samples cannot tell seven parameters; more would take minutes.
inline constexpr std::size_t kFewestSamples = 7;
inline constexpr std::size_t kMaxSamples = 10000;
inline constexpr std::size_t kMaxBlocks = 200;

/// rad/s per N m; see DesignOptions::caution. Torques a tenth of a millinewton metre off move the velocity by
/// ten rad/s at most.
inline constexpr double kEasyAmplification_rad_s_Nm = 1e5;

struct DesignOptions {
  BrakeParameters brake;                    ///< for which the experiment is designed
  BrakeState initial = BrakeState::Zero();  ///< known; position from contact (rad), velocity (rad/s)
  std::size_t samples = 300;       ///< outputs, one per kMaxStep_s; the first one is the initial state
  std::size_t block_samples = 20;  ///< samples that share one torque; samples is a multiple
  Objective objective = Objective::D;
  DesignLimits limits;
  SensorNoise noise;
  /// What the search minimises is the objective plus this times log(1 + amplification / kEasyAmplification),
  /// for objective A a seventh of it, as for every parameter of D: the best designs hang most on exact
  /// torques, and give little for it. 0: the nominal optimum, at any price.
  double caution = 0.35;
  std::uint64_t seed = 4;
  /// Local optimisations. More find better designs; time grows in proportion.
  int starts = 1440;
  /// 0: as many as the machine has. The result does not depend on it.
  int threads = 0;
  /// Called from the calling thread with the share of the work done and the best objective so far (infinite
  /// before there is one): -log det M, or log trace of the inverse of M.
  std::function<void(double fraction, double best)> progress;

  /// The first option that cannot be, in words.
  Result<void> validate() const;
};

enum class DesignTermination {
  Certified,        ///< an independent integrator confirms limits and criterion
  NothingFeasible,  ///< no start reached an experiment within the limits that identifies all parameters
  NotCertified,     ///< the independent integrator refused every candidate
};
std::string_view to_string(DesignTermination termination) noexcept;

/// Result of Procedure 1. Torques, criterion and certification are there only if certified().
struct DesignSummary {
  DesignTermination termination = DesignTermination::NothingFeasible;
  std::string message;
  std::vector<double> block_torque_Nm;
  Criterion criterion{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  Certification certification;   ///< criterion and extremes by the independent integrator
  std::int64_t simulations = 0;  ///< whole runs simulated, sensitivities or not
  double wall_s = 0.0;

  bool certified() const { return termination == DesignTermination::Certified; }
};

/// Procedure 1: torques of the blocks that minimise the objective within the limits, for the set-valued
/// friction model (the limit eps -> infinity of (4)). A multistart of gradient searches, each from the best
/// of many random experiments or of variations of the best designs so far. Repeats
/// exactly for a given seed on one machine. Only a design that certify() confirms is offered.
DesignSummary design_experiment(const DesignOptions& options);

/// One experiment, good or not, by the exact sensitivities of simulate(): what the search compares.
struct DesignEvaluation {
  Criterion criterion{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  double force_max_N = std::numeric_limits<double>::infinity();  ///< among the samples, like the speed
  double velocity_max_rad_s = std::numeric_limits<double>::infinity();
  /// Largest excess over a limit of the options, as a share of it; 0 where all are kept.
  double violation = std::numeric_limits<double>::infinity();
};
/// `block_torque_Nm`: one per block of `options`. Everything stays infinite if the run leaves the model.
DesignEvaluation evaluate_design(const DesignOptions& options, std::span<const double> block_torque_Nm);

/// One torque per sample from one per block.
std::vector<double> expand_blocks(const std::vector<double>& block_torque_Nm, std::size_t block_samples);

}  // namespace clampd
