#pragma once

#include <string>
#include <string_view>

#include "clampd/base/result.hpp"

namespace clampd::report {

/// Runs gnuplot without its user's settings on `script` and gives what it wrote to its standard output.
Result<std::string> run_gnuplot(std::string_view script);

}  // namespace clampd::report
