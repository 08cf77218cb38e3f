#pragma once

#include <optional>
#include <string>

#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"
#include "clampd/bench/embedded_station.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/check_record.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

/// What came of a check whose cause was sought.
struct SettledCheck {
  std::string text;  ///< the diagnosis, for a terminal
  nlohmann::ordered_json
      experiments;               ///< that were run, in this order; null where there is no cause to settle
  std::string problem;           ///< what went wrong while settling; empty if nothing
  std::optional<int> exit_code;  ///< then: how the sequence that went wrong ended
};

/// Diagnoses a finished check; if its cause is one of several, runs the experiments that tell them apart on
/// the same station, and diagnoses all runs together. What is found becomes the record's cause and stands in
/// its reason, here and in the store. The experiments' own records say nothing about the brake's limits: only
/// those are saved that end in a fault. What the check itself was diagnosed with is not searched for again.
SettledCheck settle_check(CheckRecord& record, bench::EmbeddedStation& station, CheckStore& store,
                          const BrakeParameters& nominal, const bench::EmbeddedStation::Progress& progress,
                          const CauseSearch& search, cli::ProgressLine& line);

}  // namespace clampd::ctl
