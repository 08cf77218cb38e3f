#pragma once

#include <string>
#include <vector>

namespace clampd::ctl {

struct IdentifyDriveCommand {
  std::vector<std::string> files;
  std::string model;  ///< file of a saved model of a drive
  std::string text;   ///< what stands in it
  std::string json;
  std::string save;
};

/// `clampctl identify --model` with a model of a drive. Returns the exit code.
int identify_drive_files(const IdentifyDriveCommand& command);

}  // namespace clampd::ctl
