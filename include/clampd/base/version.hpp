#pragma once

#include <string_view>

namespace clampd {

/// Software revision as it appears in every record; set by the build from CMakeLists.txt and git.
extern const std::string_view kVersion;

}  // namespace clampd
