#include "tools/clampd-worker/metrics.hpp"

#include <utility>

#include "clampd/base/version.hpp"
#include "clampd/http/metrics.hpp"

namespace clampd::worker {

std::string metrics_text(const std::string& worker, const reanalysis::WorkerStatus& status) {
  http::Metrics out;
  out.family("clampd_worker_build_info", "gauge", "Always 1; the labels tell what runs here.");
  out.sample(1.0, {{"version", kVersion}, {"worker", worker}});
  out.family("clampd_worker_connected", "gauge", "1 while the worker reaches its database.");
  out.sample(status.connected ? 1.0 : 0.0);
  out.family("clampd_worker_tasks_total", "counter", "Tasks since the worker started, by how they ended.");
  const reanalysis::WorkerSummary& summary = status.summary;
  for (const auto& [result, count] : {std::pair{"done", summary.done - summary.known},
                                      {"known", summary.known},
                                      {"failed", summary.failed},
                                      {"lost", summary.lost},
                                      {"given-back", summary.given_back}})
    out.sample(static_cast<double>(count), {{"result", result}});
  out.family("clampd_worker_busy_seconds_total", "counter", "Time spent on tasks, from claim to result.");
  out.sample(status.busy_s);
  out.family("clampd_queue_tasks", "gauge",
             "Tasks of all jobs that are not ended, by state, at most a minute old.");
  if (status.open) {
    out.sample(static_cast<double>(status.open->waiting), {{"state", "waiting"}});
    out.sample(static_cast<double>(status.open->claimed), {{"state", "claimed"}});
  }
  return out.text();
}

}  // namespace clampd::worker
