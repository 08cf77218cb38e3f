#pragma once

#include <cstdlib>
#include <optional>
#include <string>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "support/temporary_directory.hpp"

namespace clampd::bench {

/// Runs baselines/`script` on a directory that holds its task, and returns the file `answer` that it leaves
/// there. Nothing, and a message, where Python or its packages are missing.
inline std::optional<nlohmann::json> run_baseline(const std::string& script,
                                                  const support::TemporaryDirectory& directory,
                                                  const std::string& answer) {
  // One core, and no compiled code left in the source tree.
  const std::string command = fmt::format(
      "OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=1 /usr/bin/python3 "
      "'{}/tests/benchmarks/baselines/{}' '{}'",
      CLAMPD_SOURCE_DIR, script, directory.path(""));
  if (std::system(command.c_str()) != 0) {
    fmt::print(
        "{} failed: is Python there with scipy and numba (Debian: python3-scipy, python3-numba)? Going on "
        "without it.\n",
        script);
    return std::nullopt;
  }
  return nlohmann::json::parse(directory.read(answer));
}

}  // namespace clampd::bench
