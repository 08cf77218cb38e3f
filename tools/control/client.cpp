#include "tools/control/messages.hpp"

#include <fmt/format.h>

#include "clampd/record/file.hpp"

// Last: it brings in <resolv.h>, whose macro _res breaks Eigen's headers.
#include <httplib.h>

namespace clampd::control {

namespace {

std::string trimmed(std::string text) {
  const auto end = text.find_last_not_of(" \t\r\n");
  text.erase(end == std::string::npos ? 0 : end + 1);
  return text;
}

tl::unexpected<Error> unexpected_answer(const nlohmann::json::exception& mismatch) {
  return failure(std::string("the daemon's answer is not what this clampctl expects (") + mismatch.what() +
                 "); are both of the same version?");
}

}  // namespace

Client::Client(std::string address, int port, std::string token_file)
    : address_(std::move(address)), port_(port), token_file_(std::move(token_file)) {}

Result<nlohmann::ordered_json> Client::exchange(const std::string& method, const std::string& path,
                                                const nlohmann::ordered_json& body) const {
  httplib::Client http(address_, port_);
  http.set_connection_timeout(2);
  http.set_read_timeout(5);
  httplib::Headers headers;
  if (method == "POST") {
    const Result<std::string> token = read_file(token_file_);
    if (!token)
      return failure(token.error().message +
                     ". The daemon writes its token there when it starts; is it running, and "
                     "may you read the file?");
    headers.emplace("Authorization", "Bearer " + trimmed(*token));
  }
  const httplib::Result response =
      method == "POST" ? http.Post(path, headers, body.dump(), "application/json") : http.Get(path, headers);
  if (!response)
    return failure(
        fmt::format("no daemon answers at {}:{} ({}). Start it with `systemctl start clampd` or `clampd "
                    "--config FILE`",
                    address_, port_, httplib::to_string(response.error())));
  nlohmann::ordered_json document = nlohmann::ordered_json::parse(response->body, nullptr, false);
  if (document.is_discarded())
    return failure(fmt::format("the answer of {}:{}{} is not JSON; is another program using this port?",
                               address_, port_, path));
  if (response->status >= 300)
    return failure(document.is_object() ? document.value("error", fmt::format("status {}", response->status))
                                        : fmt::format("the daemon refused with status {}", response->status));
  return document;
}

Result<StationStatus> Client::status() const {
  const auto document = exchange("GET", "/v1/status", {});
  if (!document) return tl::unexpected(document.error());
  try {
    return nlohmann::json(*document).get<StationStatus>();
  } catch (const nlohmann::json::exception& mismatch) {
    return unexpected_answer(mismatch);
  }
}

Result<std::uint64_t> Client::start(const CheckRequest& request) const {
  const auto document = exchange("POST", "/v1/checks", nlohmann::json(request));
  if (!document) return tl::unexpected(document.error());
  try {
    return document->at("check").get<std::uint64_t>();
  } catch (const nlohmann::json::exception& mismatch) {
    return unexpected_answer(mismatch);
  }
}

Result<void> Client::next(const CheckRequest& request) const {
  return exchange("POST", "/v1/next", nlohmann::json(request)).map([](const auto&) {});
}

Result<CheckProgress> Client::progress(bool colour) const {
  const auto document = exchange("GET", colour ? "/v1/checks/current?colour=1" : "/v1/checks/current", {});
  if (!document) return tl::unexpected(document.error());
  try {
    CheckProgress progress;
    document->at("check").get_to(progress.check);
    document->at("finished").get_to(progress.finished);
    document->at("phase").get_to(progress.phase);
    document->at("repeat").get_to(progress.repeat);
    document->at("repeats").get_to(progress.repeats);
    document->at("table").get_to(progress.table);
    progress.record = document->at("record");
    return progress;
  } catch (const nlohmann::json::exception& mismatch) {
    return unexpected_answer(mismatch);
  }
}

Result<void> Client::stop() const {
  return exchange("POST", "/v1/stop", nlohmann::ordered_json::object()).map([](const auto&) {});
}

Result<void> Client::clear() const {
  return exchange("POST", "/v1/clear", nlohmann::ordered_json::object()).map([](const auto&) {});
}

}  // namespace clampd::control
