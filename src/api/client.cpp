#include "clampd/api/messages.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "clampd/http/client.hpp"
#include "clampd/record/file.hpp"

namespace clampd::api {

namespace {

std::string without_line_end(std::string text) {
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

Result<std::string> Client::token() const {
  const Result<std::string> token = read_file(token_file_);
  if (token) return without_line_end(*token);
  return failure(
      token.error().message +
      ". The daemon writes its token there when it starts; is it running, and may you read the file?");
}

Result<nlohmann::ordered_json> Client::exchange(http::Call call) const {
  const Result<http::Answer> answer = http::exchange(address_, port_, call);
  if (!answer)
    return failure(
        fmt::format("no daemon answers at {}:{} ({}). Start it with `systemctl start clampd` or `clampd "
                    "--config FILE`",
                    address_, port_, answer.error().message));
  nlohmann::ordered_json document = nlohmann::ordered_json::parse(answer->body, nullptr, false);
  if (document.is_discarded())
    return failure(fmt::format("the answer of {}:{}{} is not JSON; is another program using this port?",
                               address_, port_, call.path));
  if (answer->status >= 300)
    return failure(document.is_object() ? document.value("error", fmt::format("status {}", answer->status))
                                        : fmt::format("the daemon refused with status {}", answer->status));
  return document;
}

Result<nlohmann::ordered_json> Client::get(const std::string& path) const {
  http::Call call;
  call.path = path;
  return exchange(std::move(call));
}

Result<nlohmann::ordered_json> Client::post(const std::string& path,
                                            const nlohmann::ordered_json& body) const {
  const Result<std::string> token = this->token();
  // A stop from this machine needs none, and must not fail for a file.
  if (!token && path != "/v1/stop") return tl::unexpected(token.error());
  http::Call call;
  call.method = "POST";
  call.path = path;
  if (token) call.headers.emplace_back("Authorization", "Bearer " + *token);
  try {
    call.body = body.dump();
  } catch (const nlohmann::json::exception&) {
    return failure("the request has a text that is not valid UTF-8; the daemon takes UTF-8 only");
  }
  return exchange(std::move(call));
}

Result<StationStatus> Client::status(std::chrono::milliseconds within) const {
  http::Call call;
  call.path = "/v1/status";
  call.connect_within = std::min(within, call.connect_within);
  call.answer_within = within;
  const auto document = exchange(std::move(call));
  if (!document) return tl::unexpected(document.error());
  try {
    return nlohmann::json(*document).get<StationStatus>();
  } catch (const nlohmann::json::exception& mismatch) {
    return unexpected_answer(mismatch);
  }
}

Result<StartedCheck> Client::start(const CheckRequest& request,
                                   std::optional<std::uint64_t> stops_seen) const {
  const std::string path = stops_seen ? fmt::format("/v1/checks?stops_seen={}", *stops_seen) : "/v1/checks";
  const auto document = post(path, check_request_json(request));
  if (!document) return tl::unexpected(document.error());
  try {
    return StartedCheck{document->at("check").get<std::uint64_t>(), document->at("id").get<std::string>()};
  } catch (const nlohmann::json::exception& mismatch) {
    return unexpected_answer(mismatch);
  }
}

Result<std::string> Client::open() const {
  const auto document = post("/v1/open", nlohmann::ordered_json::object());
  if (!document) return tl::unexpected(document.error());
  try {
    return document->at("id").get<std::string>();
  } catch (const nlohmann::json::exception& mismatch) {
    return unexpected_answer(mismatch);
  }
}

Result<void> Client::next(const CheckRequest& request) const {
  return post("/v1/next", check_request_json(request)).map([](const auto&) {});
}

Result<CheckProgress> Client::progress(bool colour) const {
  const auto document = get(colour ? "/v1/checks/current?colour=1" : "/v1/checks/current");
  if (!document) return tl::unexpected(document.error());
  try {
    CheckProgress progress;
    document->at("check").get_to(progress.check);
    document->at("id").get_to(progress.id);
    document->at("finished").get_to(progress.finished);
    document->at("phase").get_to(progress.phase);
    document->at("repeat").get_to(progress.repeat);
    document->at("repeats").get_to(progress.repeats);
    progress.repeats_auto = document->value("repeats_auto", false);  // an older daemon has none
    document->at("table").get_to(progress.table);
    progress.record = document->at("record");
    return progress;
  } catch (const nlohmann::json::exception& mismatch) {
    return unexpected_answer(mismatch);
  }
}

Result<void> Client::stop() const {
  return post("/v1/stop", nlohmann::ordered_json::object()).map([](const auto&) {});
}

Result<void> Client::clear() const {
  return post("/v1/clear", nlohmann::ordered_json::object()).map([](const auto&) {});
}

}  // namespace clampd::api
