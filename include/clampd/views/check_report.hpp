#pragma once

#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/record/reference.hpp"

namespace clampd {

/// What a report on one check shows.
struct CheckReportContents {
  CheckRecord check;
  std::vector<CheckRecord>
      history;  ///< checks of the same serial number, results only, the last one saved first
  const Reference* reference = nullptr;  ///< of the trajectory that was replayed, if it is still known
  double guard_band_k = 2.0;             ///< of its limits
};

/// The report as one HTML file that needs nothing else. Errors: figures cannot be drawn.
Result<std::string> check_report(const CheckReportContents& contents);

}  // namespace clampd
