#include "clampd/api/messages.hpp"

#include <array>

#include <string_view>
#include <utility>

#include <fmt/format.h>

namespace clampd::api {

namespace {

using TextField = std::pair<std::string_view, std::string CheckRequest::*>;
constexpr std::array<TextField, 5> kTexts{{{"serial", &CheckRequest::serial},
                                           {"operator", &CheckRequest::operator_name},
                                           {"operator_name", &CheckRequest::operator_name},
                                           {"part_number", &CheckRequest::part_number},
                                           {"batch", &CheckRequest::batch}}};
constexpr std::uint32_t kMaxRepeats = 200;

std::string trimmed(const std::string& text) {
  constexpr const char* kBlanks = " \t\r\n";
  const std::size_t begin = text.find_first_not_of(kBlanks);
  if (begin == std::string::npos) return "";
  return text.substr(begin, text.find_last_not_of(kBlanks) - begin + 1);
}

Result<void> read_repeats(const nlohmann::json& value, CheckRequest& request) {
  if (value.is_string() && value.get<std::string>() == "auto") {
    request.repeats_auto = true;
    return {};
  }
  const bool whole = value.is_number_unsigned();  // never negative, no fraction, not true
  if (!whole || value.get<std::uint64_t>() < 1 || value.get<std::uint64_t>() > kMaxRepeats)
    return failure(
        fmt::format("repeats must be a whole number from 1 to {}, or \"auto\" for as many as the brake "
                    "needs; leave it out for what "
                    "the station is set to",
                    kMaxRepeats));
  request.repeats = value.get<std::uint32_t>();
  return {};
}

Result<void> read_text(const TextField& field, const nlohmann::json& value, CheckRequest& request) {
  if (!value.is_string()) return failure(fmt::format("{} must be a text", field.first));
  request.*field.second = trimmed(value.get<std::string>());
  return {};
}

Result<void> read_key(const std::string& key, const nlohmann::json& value, CheckRequest& request) {
  if (key == "repeats") return read_repeats(value, request);
  for (const TextField& field : kTexts)
    if (key == field.first) return read_text(field, value, request);
  return failure(
      fmt::format("a check request has no \"{}\"; it has serial, repeats, operator (or operator_name), "
                  "part_number, batch",
                  key));
}

}  // namespace

nlohmann::ordered_json check_request_json(const CheckRequest& request) {
  nlohmann::ordered_json document = nlohmann::ordered_json::object();
  for (const auto& [key, member] : kTexts)
    if (key != "operator_name" && !(request.*member).empty()) document[std::string(key)] = request.*member;
  if (request.repeats_auto)
    document["repeats"] = "auto";
  else if (request.repeats > 0)
    document["repeats"] = request.repeats;
  return document;
}

Result<CheckRequest> parse_check_request(const std::string& body) {
  const nlohmann::json document = nlohmann::json::parse(body, nullptr, false);
  if (document.is_discarded()) return failure("the body is not valid JSON in UTF-8");
  if (!document.is_object()) return failure("the body is not a JSON object");
  if (document.contains("operator") && document.contains("operator_name"))
    return failure("operator and operator_name are the same: give one of them");
  CheckRequest request;
  for (const auto& [key, value] : document.items())
    if (const Result<void> read = read_key(key, value, request); !read) return tl::unexpected(read.error());
  return request;
}

nlohmann::ordered_json progress_json(const CheckProgress& progress) {
  return {{"check", progress.check},
          {"id", progress.id},
          {"finished", progress.finished},
          {"phase", progress.phase},
          {"repeat", progress.repeat},
          {"repeats", progress.repeats},
          {"repeats_auto", progress.repeats_auto},
          {"record", progress.record},
          {"table", progress.table}};
}

}  // namespace clampd::api
