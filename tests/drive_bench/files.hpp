#pragma once

#include <string>
#include <vector>

#include "tests/drive_bench/drive_case.hpp"

namespace clampd::drive_bench {

/// A set as its user has it.
struct Files {
  std::vector<std::string> runs;  ///< paths
  std::string model;
};

/// Writes run-1.csv, … and model.toml into an existing folder. `all_keys` false: for programs that do
/// not know the key. Throws std::runtime_error where it cannot.
Files write_files(const Case& drawn, const std::vector<Recording>& runs, const std::string& folder,
                  bool all_keys = true);

/// The sealed answer, as JSON.
std::string answer_json(const Case& drawn);

}  // namespace clampd::drive_bench
