#pragma once

#include <span>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

using DataSeverity = DataFinding::Severity;

struct CheckedData {
  std::vector<Run> runs;              ///< all runs, mended; empty if there was nothing to mend
  std::vector<DataFinding> findings;  ///< one a kind and column, those that stop first

  bool stops() const { return !findings.empty() && findings.front().severity == DataSeverity::Stop; }
};

/// Looks at recorded data of a drive before any model does: units, time stamps, readings that are held,
/// wraps, jumps, spikes, clipping, velocity against position, torque against motion, and whether the motion
/// can show what the model asks for. All estimates are robust against single bad samples. Time grows in
/// proportion to the rows.
///
/// Errors: no run, or a run whose columns differ in length. What is wrong with the readings themselves is a
/// finding.
Result<CheckedData> check_data(std::span<const Run> runs, const DriveModel& model);

/// The findings that stop a diagnosis as one message; empty if there is none.
std::string stop_message(const CheckedData& data);

}  // namespace clampd
