#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "clampd/experiment/next_run.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/identify/systematic_misfit.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/sheet/sheet.hpp"
#include "clampd/station/verdict.hpp"

namespace clampd {

/// When a check of as many repeats as its brake needs may end, and how wide its guard bands are so that the
/// verdict errs no more often for all the looks at it: docs/repeats.md has the derivation.
class StoppingRule {
 public:
  /// Repeats before the first look: fewer cannot show whether the model fits.
  static constexpr std::uint32_t kFirstLook = kFewestRepeats;

  /// Runs that noise alone makes look as bad as this, or worse, with a smaller probability do not yet show
  /// that the model fits; below kSystematic they show that it does not, and that is counted. In between, more
  /// runs tell.
  static constexpr double kSeenToFit = 0.05;

  /// Where runs are chosen, the information at the last look may be so many times that at the first one, of a
  /// parameter that every later run is chosen for.
  static constexpr double kMostInformation = 100.0;

  /// `guard_band_k`: of the limits, for a check of a fixed number. `most`: repeats at most, at least
  /// kFirstLook. `chooses`: which trajectory a run follows depends on the ones before.
  StoppingRule(double guard_band_k, std::uint32_t most, bool chooses);

  std::uint32_t most() const { return most_; }
  /// In standard deviations that are known.
  double coverage_factor() const { return coverage_factor_; }

  /// Of this estimate, whose standard deviations are themselves estimated.
  GuardBands guard_bands(const Estimate& joint) const;

  /// Whether the check may end with what a look has found: the runs say something about the brake, agree with
  /// each other and with the model, and leave no limit in doubt. `systematic`: what they have in common
  /// beside the model.
  static bool is_enough(const Judgement& judgement, const Estimate& joint,
                        const std::optional<SystematicRecord>& systematic);

  /// Why the most that was allowed was not enough: "the most that was allowed: 21; TC in doubt".
  std::string why_most(const Judgement& judgement, const Estimate& joint,
                       const std::optional<SystematicRecord>& systematic) const;

 private:
  std::uint32_t most_;
  double coverage_factor_;
};

/// The trajectory that a further run should follow: of those that can be driven, the one after which the
/// standard deviations of what is in doubt, parameters and lines of the sheet, are expected to be smallest
/// (geometric mean). 0 where nothing is in doubt, or there is no choice.
std::uint8_t next_trajectory_for(const Judgement& judgement, const Estimate& joint,
                                 const std::vector<RunRecord>& runs, const TrajectorySet& trajectories,
                                 std::span<const Characteristic> sheet);

}  // namespace clampd
