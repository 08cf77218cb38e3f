#include "tools/clampd-worker/line_documents.hpp"

#include <algorithm>

#include "clampd/line_page/line_page.hpp"

namespace clampd::worker {
namespace {

constexpr std::chrono::seconds kKeepDocument{30};
constexpr std::chrono::seconds kKeepError{5};
/// Of different questions at once: who asks for ever new part numbers fills no memory.
constexpr std::size_t kMostKept = 16;

}  // namespace

Result<std::string> LineDocuments::get(const reanalysis::LineQuestion& question) {
  const Key key(question.span.days, question.part_number);
  if (const auto known = kept_.find(key); known != kept_.end() && Clock::now() < known->second.until)
    return known->second.text;
  Result<std::string> text =
      reanalysis::read_line(database_, question, wake_).map([this](const reanalysis::LineRows& rows) {
        nlohmann::ordered_json document = line_page::document(rows);
        document["worker"] = worker_;
        // A text that is not UTF-8 is shown with marks in it rather than not at all.
        return document.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
      });
  make_room();
  const Clock::time_point until = Clock::now() + (text ? kKeepDocument : kKeepError);
  kept_.insert_or_assign(key, Kept{text, until});
  return text;
}

void LineDocuments::make_room() {
  if (kept_.size() < kMostKept) return;
  kept_.erase(std::min_element(kept_.begin(), kept_.end(),
                               [](const auto& a, const auto& b) { return a.second.until < b.second.until; }));
}

}  // namespace clampd::worker
