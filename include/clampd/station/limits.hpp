#pragma once

#include <array>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

/// Tolerance interval of one parameter, SI. lower < upper.
struct LimitInterval {
  double lower = 0.0;
  double upper = 0.0;
};

/// Of a parameter that an effect adds to the model.
struct EffectLimit {
  std::string effect;
  std::string parameter;
  LimitInterval interval;
};

/// What a brake is judged by.
struct LimitSet {
  std::string file;  ///< where they came from
  std::string revision;
  std::string author;
  std::string changed;        ///< date, YYYY-MM-DD
  std::string sha256;         ///< of the file's text
  std::string contents;       ///< the file's text
  double guard_band_k = 2.0;  ///< coverage factor: half width of the guard band in standard deviations
  std::array<LimitInterval, kParameterCount> intervals;  ///< in the order of the parameter table
  std::vector<EffectLimit> effects;                      ///< of an extended model
};

/// Limits file (TOML): revision, author, changed, guard_band_k, and for each of the seven parameters one
/// `NAME = {lower = x, upper = x}`, either in [parameters] (SI) or in [parameters_normalised] (times
/// nominal); and for an extended model one table [effects.EFFECT] each, with PARAMETER = {lower = x, upper =
/// x} in SI. Impossible limits are errors with file, line and column: lower not below upper, a parameter
/// missing, named twice or unknown, a value not finite, a negative guard band.
Result<LimitSet> read_limits(const std::string& path);
Result<LimitSet> parse_limits(const std::string& text, const std::string& path);

/// What is different in `after`, one sentence each: "k2: upper 40.48 -> 42.24 N/rad^2". Empty if both judge
/// alike.
std::vector<std::string> changes_between(const LimitSet& before, const LimitSet& after);

/// Whether a check that estimates `model` can judge by all of these limits. Errors: a limit of an effect that
/// the model lacks, or has more than once.
Result<void> check_limits(const LimitSet& limits, const ExtendedParameters& model);

}  // namespace clampd
