#include "clampd/views/retention_view.hpp"

#include <fmt/format.h>

namespace clampd {
namespace {

std::string megabytes(std::uint64_t bytes) {
  return fmt::format("{:.1f} MB", static_cast<double>(bytes) / 1e6);
}

}  // namespace

nlohmann::ordered_json retention_json(const RetentionSummary& summary, bool done) {
  nlohmann::ordered_json waiting = nlohmann::ordered_json::object();
  for (const auto& [channel, checks] : summary.waiting) waiting[channel] = checks;
  return {{"schema", "clampd.retention/1"},   {"done", done},
          {"checks", summary.checks},         {"bytes", summary.bytes},
          {"kept_bytes", summary.kept_bytes}, {"waiting", std::move(waiting)}};
}

std::string format_retention(const RetentionSummary& summary, bool done) {
  std::string text;
  if (summary.checks.empty())
    text = fmt::format("No raw runs to remove; {} are kept.\n", megabytes(summary.kept_bytes));
  else
    text = fmt::format("Raw runs of {} checks, {} to {}, {}: {}. {} are kept.{}\n", summary.checks.size(),
                       summary.checks.front(), summary.checks.back(), done ? "removed" : "would be removed",
                       megabytes(summary.bytes), megabytes(summary.kept_bytes),
                       done ? " The file keeps its size; the next checks use the space."
                            : " Results and parameters stay. `--yes` removes them.");
  for (const auto& [channel, checks] : summary.waiting)
    text += fmt::format("{} checks keep their runs until {} has published them.\n", checks, channel);
  return text;
}

}  // namespace clampd
