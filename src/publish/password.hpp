#pragma once

#include <string>

#include "clampd/base/result.hpp"

namespace clampd::publish {

/// The first line of the file; empty if none is named.
Result<std::string> read_password(const std::string& file);

}  // namespace clampd::publish
