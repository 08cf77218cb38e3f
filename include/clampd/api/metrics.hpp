#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "clampd/api/messages.hpp"
#include "clampd/ports/brake_port.hpp"
#include "clampd/record/check_record.hpp"
#include "rt/histogram.hpp"

namespace clampd::api {

/// What a station has counted since its daemon started.
struct StationCounts {
  std::array<std::uint64_t, kVerdicts.size()> verdicts{};  ///< of saved checks
  PortHealth bus = {};
  rt::HistogramSnapshot lateness = {};  ///< of the loop's wake-ups
};

/// The station as Prometheus scrapes it (docs/metrics.md), in its text format.
std::string station_metrics(const StationStatus& status, const StationCounts& counts);

}  // namespace clampd::api
