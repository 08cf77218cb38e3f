#pragma once

#include <array>
#include <cstdint>
#include <iosfwd>
#include <string>
#include <vector>

#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd::support {

struct RepeatsCampaignOptions {
  int brakes = 1000;
  std::uint64_t seed = 1;
  /// A brake is near a limit within so many standard deviations of a fixed check of 20 repeats. By default
  /// within two of a single run: where one run does not tell on which side of the limit the brake is.
  double near_sd = 8.944;
  double near_share = 0.1;     ///< of the brakes
  double beyond_share = 0.05;  ///< of the brakes: further beyond a limit than that
  double noise = 1.0;          ///< of the sensors, in those of the shipped brake
  std::uint32_t most = 21;
  bool chooses = true;  ///< a run follows the trajectory that tells most about what is in doubt
  int threads = 1;
  std::string effect;  ///< that the model lacks, in every brake, as "friction-asymmetry=0.01"; empty: none
  int fixed_every =
      20;  ///< of the brakes far from all limits, one in so many is also checked with 20 fixed repeats
};

/// Where a brake truly lies.
enum class Nearness : std::uint8_t { Far, Near, Beyond };

/// One plan's result on one brake.
struct PlanResult {
  bool checked = false;
  Verdict verdict = Verdict::Error;
  bool marginal = false;
  bool misfit_marked = false;  ///< the repeats have something in common that the model lacks, and it counts
  std::uint32_t repeats = 0;
  double duration_s = 0.0;  ///< bench time
  std::string reason;
};

struct BrakeResult {
  Nearness nearness = Nearness::Far;
  int limit = -1;  ///< that it is near to or beyond: parameter * 2 + (upper ? 1 : 0)
  bool is_good = true;
  PlanResult automatic, fixed;
};

struct RepeatsCampaign {
  std::vector<BrakeResult> brakes;
  RepeatsCampaignOptions options;
};

/// How often a plan was wrong about the brakes that it was tried on.
struct Errors {
  int checked = 0;
  int wrong_accepts = 0, wrong_rejects = 0;  ///< whatever the mark
  int unmarked_accepts = 0, unmarked_rejects = 0;
  int marginal = 0;
  int misfit_marked = 0;
  int no_verdict = 0;  ///< ERROR and the like
};
Errors errors_of(const RepeatsCampaign& campaign, PlanResult BrakeResult::*plan, Nearness nearness);

/// Whole checks of simulated brakes on the virtual clock, by the station's own code. A brake's parameters
/// differ from nominal by up to 13 %, uniformly; of a share of the brakes one is moved near a limit of
/// configs/limits.toml, uniformly on both sides of it, of another share beyond one. Every brake is checked
/// with as many repeats as it needs; those near or beyond, and some of the others, also with 20: of the same
/// brake with the same noise, so that the two plans see the same runs.
RepeatsCampaign run_repeats_campaign(const RepeatsCampaignOptions& options);

void print(std::ostream& out, const RepeatsCampaign& campaign);

}  // namespace clampd::support
