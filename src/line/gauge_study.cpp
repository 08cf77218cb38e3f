#include "clampd/line/gauge_study.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <string_view>

#include <fmt/format.h>

namespace clampd {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

Result<void> study(std::vector<GaugeQuantity>& quantities, const std::map<std::string, double>& tolerances) {
  for (GaugeQuantity& quantity : quantities) {
    quality::GaugeOptions options;
    options.tolerance = quantity.upper - quantity.lower;
    if (const auto given = tolerances.find(quantity.name); given != tolerances.end())
      options.tolerance = given->second;
    Result<quality::GaugeStudy> found = quality::gauge_anova(quantity.readings, options);
    if (!found) return failure(fmt::format("{}: {}", quantity.name, found.error().message));
    quantity.study = std::move(*found);
  }
  return {};
}

std::vector<std::string> cells_of(std::string_view line) {
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  std::vector<std::string> cells;
  while (true) {
    const std::size_t comma = line.find(',');
    std::string_view cell = line.substr(0, comma);
    while (!cell.empty() && cell.front() == ' ') cell.remove_prefix(1);
    while (!cell.empty() && cell.back() == ' ') cell.remove_suffix(1);
    cells.emplace_back(cell);
    if (comma == std::string_view::npos) return cells;
    line.remove_prefix(comma + 1);
  }
}

}  // namespace

Result<std::vector<GaugeQuantity>> gauge_of_checks(const std::vector<CheckRecord>& checks) {
  std::vector<GaugeQuantity> quantities;
  for (const CheckRecord& check : checks) {
    if (!is_about_the_brake(check.verdict) || check.voided) continue;
    for (const ParameterRecord& parameter : check.parameters) {
      auto found = std::find_if(quantities.begin(), quantities.end(),
                                [&](const auto& known) { return known.name == parameter.name; });
      if (found == quantities.end())
        found = quantities.insert(found,
                                  {parameter.name, parameter.unit, parameter.lower, parameter.upper, {}, {}});
      found->readings.push_back({check.serial, check.operator_name, parameter.value});
    }
  }
  if (quantities.empty())
    return failure(
        "no valid checks to study: check each of several brakes several times by several operators "
        "(`clampctl run --serial S --operator O`), and choose those checks with --since or --batch");
  if (const Result<void> done = study(quantities, {}); !done) return tl::unexpected(done.error());
  return quantities;
}

Result<std::vector<GaugeQuantity>> gauge_of_csv(const std::string& text, const std::string& name,
                                                const std::map<std::string, double>& tolerances) {
  std::vector<GaugeQuantity> quantities;
  std::vector<std::size_t> columns;  ///< of the quantities
  std::size_t part = std::string::npos, op = std::string::npos, width = 0;
  std::size_t line_number = 0;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::vector<std::string> cells = cells_of(std::string_view(text).substr(at, end - at));
    at = end + 1;
    ++line_number;
    if (cells.size() == 1 && cells[0].empty()) continue;
    if (width == 0) {
      width = cells.size();
      for (std::size_t i = 0; i < width; ++i) {
        if (cells[i] == "part" || cells[i] == "serial")
          part = i;
        else if (cells[i] == "operator")
          op = i;
        else if (cells[i] != "trial") {
          quantities.push_back({cells[i], "", kNone, kNone, {}, {}});
          columns.push_back(i);
        }
      }
      if (part == std::string::npos || op == std::string::npos || quantities.empty())
        return failure(
            fmt::format("{}:{}: a gauge study needs the columns part, operator and at least one of values",
                        name, line_number));
      continue;
    }
    if (cells.size() != width)
      return failure(
          fmt::format("{}:{}: {} columns, the header has {}", name, line_number, cells.size(), width));
    for (std::size_t i = 0; i < quantities.size(); ++i) {
      const std::string& cell = cells[columns[i]];
      double value = kNone;
      const auto [rest, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
      if (error != std::errc{} || rest != cell.data() + cell.size() || !std::isfinite(value))
        return failure(
            fmt::format("{}:{}:{}: '{}' is not a number", name, line_number, columns[i] + 1, cell));
      quantities[i].readings.push_back({cells[part], cells[op], value});
    }
  }
  if (width == 0) return failure(fmt::format("{}: there is no study in it: the file is empty", name));
  for (const auto& [column, tolerance] : tolerances)
    if (std::none_of(quantities.begin(), quantities.end(),
                     [&c = column](const auto& quantity) { return quantity.name == c; }))
      return failure(fmt::format("{}: has no column {} to set a tolerance for", name, column));
  if (const Result<void> done = study(quantities, tolerances); !done)
    return failure(fmt::format("{}: {}", name, done.error().message));
  return quantities;
}

}  // namespace clampd
