#pragma once

#include <optional>
#include <string>

#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"
#include "clampd/brake/parameters.hpp"
#include "clampd/record/check_record.hpp"
#include "tools/assembly/embedded_station.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

/// What came of a check whose cause was sought.
struct SettledCheck {
  std::string text;              ///< the diagnosis, for a terminal
  nlohmann::ordered_json cause;  ///< of clampd.check/1; null where the base model explains the runs
  std::string problem;           ///< what went wrong while settling; empty if nothing
  std::optional<int> exit_code;  ///< then: how the sequence that went wrong ended
};

/// Diagnoses a finished check; if its cause is one of several, runs the experiments that tell them apart on
/// the same station, and diagnoses all runs together. Their records say nothing about the brake's limits:
/// only those are saved that end in a fault.
SettledCheck settle_check(const CheckRecord& record, assembly::EmbeddedStation& station, CheckStore& store,
                          const BrakeParameters& nominal, const assembly::EmbeddedStation::Progress& progress,
                          cli::ProgressLine& line);

}  // namespace clampd::ctl
