#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

namespace clampd::support {

/// Where real data lie that are not part of the project, e.g. "data/dbc": in the folder CLAMPD_SHARED, or in
/// the one beside the project. It may be missing; a test then skips and says so.
inline std::filesystem::path shared_data(const std::string& what) {
  const char* shared = std::getenv("CLAMPD_SHARED");
  return (shared != nullptr ? std::filesystem::path(shared)
                            : std::filesystem::path(CLAMPD_SOURCE_DIR) / "../shared") /
         what;
}

}  // namespace clampd::support
