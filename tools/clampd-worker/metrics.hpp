#pragma once

#include <memory>
#include <mutex>
#include <string>

#include "clampd/base/result.hpp"
#include "clampd/http/server.hpp"
#include "clampd/reanalysis/worker.hpp"

namespace clampd::worker {

/// Serves what a worker is doing at /metrics, for Prometheus (docs/metrics.md).
class MetricsServer {
 public:
  explicit MetricsServer(std::string worker) : worker_(std::move(worker)) {}

  /// `where`: "ADDRESS:PORT". Errors: no such text, or the address is taken or not this machine's.
  Result<void> start(const std::string& where);
  void set(const reanalysis::WorkerStatus& status);

 private:
  std::string text() const;

  const std::string worker_;
  mutable std::mutex mutex_;
  reanalysis::WorkerStatus status_;
  std::unique_ptr<http::Server> server_;  ///< last: its thread uses what is above
};

}  // namespace clampd::worker
