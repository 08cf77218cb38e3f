#include "clampd/views/limits_view.hpp"

#include <fmt/format.h>

#include "clampd/station/limits.hpp"

namespace clampd {

std::vector<LimitsStep> limits_steps(const std::vector<LimitsRevision>& history) {
  std::vector<LimitsStep> steps;
  for (const LimitsRevision& limits : history) {
    LimitsStep step{limits, {}, false};
    if (!steps.empty()) {
      const LimitsRevision& before = steps.back().limits;
      const Result<LimitSet> old = parse_limits(before.contents, before.file);
      const Result<LimitSet> now = parse_limits(limits.contents, limits.file);
      if (old && now)
        step.changes = changes_between(*old, *now);
      else  // written for another version of clampd
        step.changes = {(old ? now : old).error().message};
      step.same_revision = before.revision == limits.revision && !step.changes.empty();
    }
    steps.push_back(std::move(step));
  }
  return steps;
}

nlohmann::ordered_json limits_json(const std::vector<LimitsStep>& steps) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const LimitsStep& step : steps)
    list.push_back({{"revision", step.limits.revision},
                    {"author", step.limits.author},
                    {"changed", step.limits.changed},
                    {"first_used", step.limits.first_used},
                    {"file", step.limits.file},
                    {"sha256", step.limits.sha256},
                    {"changes", step.changes},
                    {"same_revision", step.same_revision},
                    {"contents", step.limits.contents}});
  return {{"schema", "clampd.limits/1"}, {"limits", std::move(list)}};
}

std::string format_limits(const std::vector<LimitsStep>& steps) {
  if (steps.empty()) return "No limits were used yet.\n";
  std::string text;
  for (const LimitsStep& step : steps) {
    const LimitsRevision& limits = step.limits;
    text += fmt::format("revision {}  by {}, dated {}, first used {}\n  {}, sha256 {:.12}\n", limits.revision,
                        limits.author.empty() ? "(no author)" : limits.author,
                        limits.changed.empty() ? "-" : limits.changed, limits.first_used, limits.file,
                        limits.sha256);
    if (step.same_revision)
      text += "  WARNING: it judges differently under the same revision number; raise the revision\n";
    for (const std::string& change : step.changes) text += fmt::format("  {}\n", change);
    if (step.changes.empty() && &step != &steps.front()) text += "  judges as before\n";
  }
  return text;
}

}  // namespace clampd
