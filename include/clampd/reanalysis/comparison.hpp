#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/reanalysis/jobs.hpp"

namespace clampd::reanalysis {

struct ChangedVerdict {
  std::string check;
  std::string serial;
  std::string before;
  std::string after;
  std::string reason;  ///< of the one after
};

/// A line of the sheet that was judged before and after, and otherwise.
struct ChangedLine {
  std::string check;
  std::string serial;
  std::string line;
  std::string before;  ///< "pass", "marginal", "fail"; empty: without limits, or not known
  std::string after;
};

/// How one parameter moved over all checks that have it before and after.
struct MovedParameter {
  std::string name;
  std::string unit;
  std::int64_t checks = 0;
  double mean = 0.0;        ///< after minus before, in `unit`
  double largest = 0.0;     ///< the one of largest size, with its sign
  std::string largest_in;   ///< that check
  double largest_sd = 0.0;  ///< the largest size over the standard deviation before; infinite if that was 0
};

struct Comparison {
  std::int64_t checks = 0;
  std::vector<ChangedVerdict> verdicts;    ///< that are not what they were
  std::vector<MovedParameter> parameters;  ///< in the order in which they are first met
  std::vector<ChangedLine> lines;          ///< of sheets, by name; those that only one of the two has are left out
  /// Checks of as many repeats as needed, judged with another guard band than before: the limits' guard_band_k or
  /// the version is another one.
  std::int64_t other_guard_bands = 0;
  /// Checks of which it is not on record whether their number of repeats was fixed; judged as if it was.
  std::int64_t unknown_stopping = 0;
};

/// Errors: a document is none of clampd.reanalysis/2, or /1, which had neither sheet nor stopping rule.
Result<Comparison> compare(const std::vector<ComparedCheck>& checks);

}  // namespace clampd::reanalysis
