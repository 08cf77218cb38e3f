#include "tools/clampd-worker/metrics.hpp"

#include <charconv>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/version.hpp"
#include "clampd/http/metrics.hpp"

namespace clampd::worker {

Result<void> MetricsServer::start(const std::string& where) {
  const std::size_t colon = where.rfind(':');
  int port = 0;
  const char* const end = where.data() + where.size();
  if (colon == std::string::npos || colon == 0 ||
      std::from_chars(where.data() + colon + 1, end, port).ptr != end || port < 1 || port > 65'535)
    return failure(fmt::format("--metrics {}: give an address and a port, as in 127.0.0.1:8372", where));
  http::Settings settings;
  settings.address = where.substr(0, colon);
  settings.port = port;
  auto server = http::Server::start(
      std::move(settings), [this](const http::Request& request) -> std::variant<http::Response, http::Job> {
        if (request.path != "/metrics") return http::refusal(404, "there is /metrics only");
        if (request.method != "GET" && request.method != "HEAD") {
          http::Response refused = http::refusal(405, "there is GET only");
          refused.headers.emplace_back("Allow", "GET, HEAD");
          return refused;
        }
        return http::Response{200, text(), http::Metrics::kType};
      });
  if (!server) return failure(fmt::format("--metrics {}: {}", where, server.error().message));
  server_ = std::move(*server);
  return {};
}

void MetricsServer::set(const reanalysis::WorkerStatus& status) {
  const std::lock_guard lock(mutex_);
  status_ = status;
}

std::string MetricsServer::text() const {
  reanalysis::WorkerStatus status;
  {
    const std::lock_guard lock(mutex_);
    status = status_;
  }
  http::Metrics out;
  out.family("clampd_worker_build_info", "gauge", "Always 1; the labels tell what runs here.");
  out.sample(1.0, {{"version", kVersion}, {"worker", worker_}});
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
