#pragma once

#include <string>

#include "clampd/reanalysis/worker.hpp"

namespace clampd::worker {

/// What a worker is doing, as Prometheus scrapes it (docs/metrics.md).
std::string metrics_text(const std::string& worker, const reanalysis::WorkerStatus& status);

}  // namespace clampd::worker
