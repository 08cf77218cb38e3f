#include "tools/clampd-worker/line_documents.hpp"

#include <algorithm>

#include "clampd/line_page/line_page.hpp"

namespace clampd::worker {
namespace {

constexpr std::chrono::seconds kKeepDocument{30};
constexpr std::chrono::minutes kKeepAttribution{5};
constexpr std::chrono::seconds kKeepError{5};
/// Of different questions at once: who asks for ever new part numbers fills no memory.
constexpr std::size_t kMostKept = 16;

}  // namespace

Result<std::string> LineDocuments::get(const reanalysis::LineQuestion& question) {
  Kept& kept = this->kept({question.span.days, question.part_number});
  if (Clock::now() < kept.until) return kept.text;
  kept.text = reanalysis::read_line(database_, question, wake_).map([&](const reanalysis::LineRows& rows) {
    if (Clock::now() >= kept.attribution_until) {
      kept.attribution = line_page::attribution_of(rows);
      kept.attribution_until = Clock::now() + kKeepAttribution;
    }
    nlohmann::ordered_json document = line_page::document(rows, kept.attribution);
    document["worker"] = worker_;
    // A text that is not UTF-8 is shown with marks in it rather than not at all.
    return document.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
  });
  kept.until = Clock::now() + (kept.text ? kKeepDocument : kKeepError);
  return kept.text;
}

/// Makes room for it where it is new.
LineDocuments::Kept& LineDocuments::kept(const Key& key) {
  if (kept_.size() >= kMostKept && !kept_.contains(key))
    kept_.erase(std::min_element(kept_.begin(), kept_.end(), [](const auto& a, const auto& b) {
      return a.second.until < b.second.until;
    }));
  return kept_[key];
}

}  // namespace clampd::worker
