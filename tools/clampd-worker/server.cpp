#include "tools/clampd-worker/server.hpp"

#include <algorithm>
#include <charconv>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "clampd/http/metrics.hpp"
#include "clampd/http/screen.hpp"
#include "tools/clampd-worker/metrics.hpp"
#include "tools/dashboard/assets.hpp"

namespace clampd::worker {
namespace {

/// One thread for the documents, below the one that identifies runs; whoever comes while eight wait is
/// refused.
constexpr std::size_t kDocuments = 0;
const std::vector<http::PoolSize> kPools{{1, 8, 19}};
constexpr std::size_t kLongestPartNumber = 200;

http::Response document_or_refusal(const Result<std::string>& document) {
  if (!document) return http::refusal(503, document.error().message);
  return {200, *document};
}

}  // namespace

Server::Server(const std::string& worker, publish::PostgresqlSettings database)
    : worker_(worker), documents_(worker, std::move(database)) {}

Server::~Server() {
  documents_.stop();
}

Result<void> Server::start(const std::string& where) {
  const std::size_t colon = where.rfind(':');
  int port = 0;
  const char* const end = where.data() + where.size();
  if (colon == std::string::npos || colon == 0 ||
      std::from_chars(where.data() + colon + 1, end, port).ptr != end || port < 1 || port > 65'535)
    return failure(fmt::format("--serve {}: give an address and a port, as in 127.0.0.1:8372", where));
  http::Settings settings;
  settings.address = where.substr(0, colon);
  settings.port = port;
  settings.pools = kPools;
  settings.headers = http::screen_headers();
  auto server = http::Server::start(std::move(settings),
                                    [this](const http::Request& request) { return route(request); });
  if (!server) return failure(fmt::format("--serve {}: {}", where, server.error().message));
  server_ = std::move(*server);
  return {};
}

void Server::set(const reanalysis::WorkerStatus& status) {
  const std::lock_guard lock(mutex_);
  status_ = status;
}

std::variant<http::Response, http::Job> Server::route(const http::Request& request) {
  const auto files = dashboard::line_assets();
  const auto file = std::find_if(files.begin(), files.end(),
                                 [&](const http::ScreenFile& one) { return one.path == request.path; });
  if (file == files.end() && request.path != "/line.json" && request.path != "/metrics")
    return http::refusal(404, "there are / (the page of the line), /line.json and /metrics");
  if (request.method != "GET" && request.method != "HEAD") {
    http::Response refused = http::refusal(405, "there is GET only");
    refused.headers.emplace_back("Allow", "GET, HEAD");
    return refused;
  }
  if (file != files.end()) return http::Response{200, std::string(file->content), file->type};
  if (request.path == "/metrics") return http::Response{200, metrics(), http::Metrics::kType};
  return route_document(request);
}

std::variant<http::Response, http::Job> Server::route_document(const http::Request& request) {
  reanalysis::LineQuestion question;
  if (request.has_parameter("days")) {
    const std::string_view days = request.parameter("days");
    const auto& spans = reanalysis::kLineSpans;
    const auto span = std::find_if(spans.begin(), spans.end(),
                                   [&](const auto& one) { return std::to_string(one.days) == days; });
    if (span == spans.end()) return http::refusal(400, "days must be one of 1, 7, 30, 90, 365");
    question.span = *span;
  }
  if (request.has_parameter("part_number")) {
    question.part_number = std::string(request.parameter("part_number"));
    if (question.part_number->size() > kLongestPartNumber)
      return http::refusal(400, fmt::format("a part number has at most {} bytes", kLongestPartNumber));
  }
  http::Job job;
  job.pool = kDocuments;
  job.answer = [this, question](const http::Request&) {
    return document_or_refusal(documents_.get(question));
  };
  return job;
}

std::string Server::metrics() const {
  const std::lock_guard lock(mutex_);
  return metrics_text(worker_, status_);
}

}  // namespace clampd::worker
