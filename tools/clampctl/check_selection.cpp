#include "tools/clampctl/check_selection.hpp"

#include <string>

#include <CLI/CLI.hpp>

namespace clampd::ctl {

namespace {

const CLI::Validator kMoment(
    [](std::string& text) -> std::string {
      if (is_filter_time(text)) return {};
      return "'" + text + "' is no date 2026-11-21 or time 2026-11-21T14:30Z (UTC)";
    },
    "TIME");

}  // namespace

std::shared_ptr<CheckFilter> add_check_selection(CLI::App& command, std::uint32_t limit) {
  auto filter = std::make_shared<CheckFilter>();
  filter->limit = limit;
  constexpr const char* kGroup = "Which checks";
  command.add_option("--serial", filter->serial, "only of this brake")->group(kGroup);
  command.add_option("--part-number", filter->part_number, "only of this part number")->group(kGroup);
  command.add_option("--batch", filter->batch, "only of this batch")->group(kGroup);
  command.add_option("--operator", filter->operator_name, "only by this operator")->group(kGroup);
  command
      .add_option_function<std::string>(
          "--verdict", [filter](const std::string& text) { filter->verdict = parse_verdict(text); },
          "only with this verdict")
      ->check(CLI::IsMember({"PASS", "FAIL", "ERROR", "TIMEOUT", "ABORTED"}))
      ->group(kGroup);
  command.add_option("--since", filter->since, "only started then or later (date, or UTC time)")
      ->check(kMoment)
      ->group(kGroup);
  command.add_option("--until", filter->until, "only started then or earlier; a date includes its whole day")
      ->check(kMoment)
      ->group(kGroup);
  command.add_option("--limit", filter->limit, "at most so many, newest first")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str()
      ->group(kGroup);
  return filter;
}

}  // namespace clampd::ctl
