#pragma once

#include <cstdint>
#include <string>

#include "clampd/identify/estimate.hpp"
#include "clampd/identify/systematic_misfit.hpp"
#include "clampd/station/verdict.hpp"

namespace clampd {

/// When a check of as many repeats as its brake needs may end, and how wide its guard bands are so that the
/// verdict errs no more often for all the looks at it: docs/repeats.md has the derivation.
class StoppingRule {
 public:
  /// Repeats before the first look: fewer cannot show whether the model fits.
  static constexpr std::uint32_t kFirstLook = kFewestRepeats;

  /// `guard_band_k`: of the limits, for a check of a fixed number. `most`: repeats at most, at least
  /// kFirstLook.
  StoppingRule(double guard_band_k, std::uint32_t most);

  std::uint32_t most() const { return most_; }
  /// In standard deviations that are known.
  double coverage_factor() const { return coverage_factor_; }

  /// Of this estimate, whose standard deviations are themselves estimated.
  GuardBands guard_bands(const Estimate& joint) const;

  /// Whether the check may end with what a look has found: the runs say something about the brake, agree with
  /// each other, and leave no limit in doubt.
  static bool is_enough(const Judgement& judgement, const Estimate& joint);

  /// Why the most that was allowed was not enough: "the most that was allowed: 21; TC in doubt".
  std::string why_most(const Judgement& judgement, const Estimate& joint) const;

 private:
  std::uint32_t most_;
  double coverage_factor_;
};

}  // namespace clampd
