#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <variant>

#include "clampd/base/result.hpp"
#include "clampd/http/server.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/reanalysis/worker.hpp"
#include "tools/clampd-worker/line_documents.hpp"

namespace clampd::worker {

/// Serves the page of the line (docs/line.md), the document that it is drawn from, and what this worker is
/// doing, for Prometheus (docs/metrics.md).
class Server {
 public:
  Server(const std::string& worker, publish::PostgresqlSettings database);
  ~Server();

  /// `where`: "ADDRESS:PORT". Errors: no such text, or the address is taken or not this machine's.
  Result<void> start(const std::string& where);
  void set(const reanalysis::WorkerStatus& status);

 private:
  std::variant<http::Response, http::Job> route(const http::Request& request);
  std::variant<http::Response, http::Job> route_document(const http::Request& request);
  std::string metrics() const;

  const std::string worker_;
  mutable std::mutex mutex_;
  reanalysis::WorkerStatus status_;
  LineDocuments documents_;
  std::unique_ptr<http::Server> server_;  ///< last: its threads use what is above
};

}  // namespace clampd::worker
