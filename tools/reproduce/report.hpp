#pragma once

#include <string>

#include "clampd/base/result.hpp"
#include "tools/reproduce/study.hpp"

namespace clampd::reproduce {

/// The study as one HTML file. Errors: gnuplot is missing or fails.
Result<std::string> report_html(const Study& study);

}  // namespace clampd::reproduce
