#include "clampd/publish/document.hpp"

#include <algorithm>

#include "clampd/archive/json.hpp"

namespace clampd::publish {
namespace {

using nlohmann::ordered_json;

/// PostgreSQL's jsonb has no NUL.
void drop_nul(ordered_json& value) {
  if (value.is_string()) {
    auto& text = value.get_ref<std::string&>();
    text.erase(std::remove(text.begin(), text.end(), '\0'), text.end());
  } else if (value.is_structured()) {
    for (auto& inner : value) drop_nul(inner);
  }
}

}  // namespace

std::string publication_document(const CheckRecord& record, std::int64_t sequence) {
  ordered_json document = check_json(record);
  for (auto& run : document.at("runs")) {
    run.erase("rows");  // of the station's own archive
    run.erase("removed");
  }
  document["outbox"] = {{"sequence", sequence}};
  drop_nul(document);
  return document.dump(-1, ' ', false, ordered_json::error_handler_t::replace);
}

}  // namespace clampd::publish
