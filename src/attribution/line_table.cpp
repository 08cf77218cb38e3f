#include "clampd/attribution/line_table.hpp"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <cstring>
#include <fstream>
#include <optional>
#include <string_view>
#include <unordered_map>
#include <unordered_set>

#include <fmt/format.h>

namespace clampd::attribution {
namespace {

/// Cells of stations and periods together: a likelihood costs their third power.
constexpr int kMostCells = 400;
constexpr int kFewestPeriods = 4;
constexpr int kMostPeriods = 24;
/// A period of a station shall have so many checks on average.
constexpr std::size_t kChecksInCell = 5;

/// Names as numbers, in the order of their appearance.
class Names {
 public:
  std::int32_t number(std::string_view name) {
    return numbers_.try_emplace(std::string(name), static_cast<std::int32_t>(numbers_.size())).first->second;
  }
  std::vector<std::string> all() const {
    std::vector<std::string> names(numbers_.size());
    for (const auto& [name, number] : numbers_) names[static_cast<std::size_t>(number)] = name;
    return names;
  }
  int size() const { return static_cast<int>(numbers_.size()); }

 private:
  std::unordered_map<std::string, std::int32_t> numbers_;
};

bool read_number(std::string_view text, int& value) {
  const auto [rest, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc{} && rest == text.data() + text.size();
}

bool read_number(std::string_view text, double& value) {
  const auto [rest, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc{} && rest == text.data() + text.size() && std::isfinite(value);
}

/// Seconds since 1970 of a time of the records, YYYY-MM-DDTHH:MM:SS[.mmm]Z; a blank may stand for T.
bool read_time(std::string_view text, double& seconds) {
  int year = 0, month = 0, day = 0, hour = 0, minute = 0;
  double second = 0.0;
  if (!text.empty() && text.back() == 'Z') text.remove_suffix(1);
  if (text.size() < 19 || text[4] != '-' || text[7] != '-' || (text[10] != 'T' && text[10] != ' ') ||
      text[13] != ':' || text[16] != ':')
    return false;
  if (!read_number(text.substr(0, 4), year) || !read_number(text.substr(5, 2), month) ||
      !read_number(text.substr(8, 2), day) || !read_number(text.substr(11, 2), hour) ||
      !read_number(text.substr(14, 2), minute) || !read_number(text.substr(17), second))
    return false;
  const std::chrono::year_month_day date{std::chrono::year(year),
                                         std::chrono::month(static_cast<unsigned>(month)),
                                         std::chrono::day(static_cast<unsigned>(day))};
  if (!date.ok() || hour > 23 || minute > 59 || second >= 61.0) return false;
  seconds = 86400.0 * std::chrono::sys_days(date).time_since_epoch().count() + 3600.0 * hour + 60.0 * minute +
            second;
  return true;
}

/// A line of RFC 4180 in cells. Quoted cells lose their quotes; doubled quotes in them stay doubled, since no
/// cell that is compared has any.
void split(std::string_view line, std::vector<std::string_view>& cells) {
  cells.clear();
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  std::size_t at = 0;
  while (true) {
    if (at < line.size() && line[at] == '"') {
      std::size_t end = at + 1;
      while (end < line.size() && (line[end] != '"' || (end + 1 < line.size() && line[end + 1] == '"')))
        end += line[end] == '"' ? 2 : 1;
      cells.push_back(line.substr(at + 1, std::min(end, line.size()) - at - 1));
      at = end + 1;
    } else {
      const std::size_t end = std::min(line.find(',', at), line.size());
      cells.push_back(line.substr(at, end - at));
      at = end;
    }
    if (at >= line.size()) return;
    ++at;
    if (at == line.size()) {
      cells.emplace_back();
      return;
    }
  }
}

/// The next line of the table, which goes on where a quoted cell has a line break. Counts lines of the file.
bool next_line(std::istream& input, std::string& line, std::size_t& number) {
  if (!std::getline(input, line)) return false;
  ++number;
  std::string more;
  while (std::count(line.begin(), line.end(), '"') % 2 != 0 && std::getline(input, more)) {
    ++number;
    line += '\n' + more;
  }
  return true;
}

constexpr std::size_t kAbsent = static_cast<std::size_t>(-1);

struct Columns {
  std::size_t record = kAbsent, serial = kAbsent, part_number = kAbsent, batch = kAbsent, station = kAbsent,
              fixture = kAbsent, started = kAbsent, verdict = kAbsent, simulated = kAbsent, voided = kAbsent,
              width = 0;
  struct Parameter {
    std::size_t number;  ///< in the table
    std::size_t value, deviation;
  };
  std::vector<Parameter> parameters;
};

class TableOfFiles {
 public:
  Result<void> read(const std::string& file) {
    std::ifstream input(file);
    if (!input) return failure(fmt::format("{}: cannot be read: {}", file, std::strerror(errno)));
    std::string line;
    std::size_t number = 0;
    if (!next_line(input, line, number)) return failure(fmt::format("{}: is empty", file));
    split(line, cells_);
    Columns columns;
    if (const Result<void> found = find_columns(file, columns); !found) return found;
    while (next_line(input, line, number)) {
      if (line.empty() || line == "\r") continue;
      split(line, cells_);
      if (cells_.size() != columns.width)
        return failure(
            fmt::format("{}:{}: {} columns, the header has {}", file, number, cells_.size(), columns.width));
      if (const Result<void> taken = take(columns, fmt::format("{}:{}", file, number)); !taken) return taken;
    }
    return {};
  }

  Result<LineTable> finish(std::size_t least) {
    leave_out_simulated();
    if (table_.checks() < least)
      return failure(fmt::format(
          "{} of {} rows are valid checks: too few ({} neither PASS nor FAIL, {} void, "
          "{} incomplete)",
          table_.checks(), table_.rows, table_.invalid, table_.voided, table_.incomplete));
    Layout& layout = table_.layout;
    table_.brakes = keep_used(layout.brake, brakes_.all(), layout.brakes);
    table_.part_number = part_number_.value_or("");
    table_.stations = keep_used(layout.station, stations_.all(), layout.stations);
    table_.fixtures = keep_used(layout.fixture, fixtures_.all(), layout.fixtures);
    table_.batches = keep_used(layout.batch, batches_.all(), layout.batches);
    if (table_.checks() > 0) divide_time();
    table_.started_s = std::move(started_);
    return std::move(table_);
  }

 private:
  Result<void> find_columns(const std::string& file, Columns& columns) {
    columns.width = cells_.size();
    const auto column = [&](std::string_view name) {
      const auto found = std::find(cells_.begin(), cells_.end(), name);
      return found == cells_.end() ? kAbsent : static_cast<std::size_t>(found - cells_.begin());
    };
    columns.record = column("record");
    columns.serial = column("serial");
    columns.part_number = column("part_number");
    columns.batch = column("batch");
    columns.station = column("station");
    columns.fixture = column("fixture");
    columns.started = column("started");
    columns.verdict = column("verdict");
    columns.simulated = column("simulated");
    columns.voided = column("void");
    for (const auto& [name, at] :
         {std::pair("serial", columns.serial), std::pair("station", columns.station),
          std::pair("started", columns.started), std::pair("verdict", columns.verdict)})
      if (at == kAbsent)
        return failure(fmt::format(
            "{}:1: there is no column {}: a table as `clampctl results --csv` writes it is needed", file,
            name));
    for (std::size_t i = 0; i < cells_.size(); ++i) {
      const std::string_view cell = cells_[i];
      const std::size_t bracket = cell.find(" [");
      if (bracket == std::string_view::npos || cell.starts_with("sheet ")) continue;
      const std::size_t deviation =
          column(fmt::format("{} sd{}", cell.substr(0, bracket), cell.substr(bracket)));
      if (deviation == kAbsent) continue;
      const std::string name(cell.substr(0, bracket)),
          unit(cell.substr(bracket + 2, cell.size() - bracket - 3));
      auto known = std::find_if(table_.parameters.begin(), table_.parameters.end(),
                                [&](const auto& p) { return p.name == name; });
      if (known != table_.parameters.end() && known->unit != unit)
        return failure(
            fmt::format("{}:1: {} is in {} here and in {} in another file", file, name, unit, known->unit));
      if (known == table_.parameters.end() && files_ > 0)
        return failure(fmt::format("{}:1: has the parameter {}, which other files do not have", file, name));
      if (known == table_.parameters.end()) known = table_.parameters.insert(known, {name, unit, {}, {}});
      columns.parameters.push_back(
          {static_cast<std::size_t>(known - table_.parameters.begin()), i, deviation});
    }
    if (columns.parameters.size() != table_.parameters.size() || columns.parameters.empty())
      return failure(
          fmt::format("{}:1: has {} parameters with a standard deviation (columns NAME [unit] and NAME sd "
                      "[unit]), {} are needed",
                      file, columns.parameters.size(), std::max<std::size_t>(1, table_.parameters.size())));
    ++files_;
    return {};
  }

  Result<void> take(const Columns& columns, const std::string& place) {
    const auto cell = [&](std::size_t column) {
      return column == kAbsent ? std::string_view() : cells_[column];
    };
    ++table_.rows;
    if (!cell(columns.voided).empty()) return ++table_.voided, Result<void>{};
    if (cell(columns.verdict) != "PASS" && cell(columns.verdict) != "FAIL")
      return ++table_.invalid, Result<void>{};
    double started = 0.0;
    if (cell(columns.serial).empty() || cell(columns.station).empty() || cell(columns.started).empty())
      return ++table_.incomplete, Result<void>{};
    if (!read_time(cell(columns.started), started))
      return failure(fmt::format("{}:{}: '{}' is no time YYYY-MM-DDTHH:MM:SSZ", place, columns.started + 1,
                                 cell(columns.started)));
    const std::string_view part = cell(columns.part_number);
    if (!part_number_) part_number_ = part;
    if (*part_number_ != part)
      return failure(
          fmt::format("{}: part number '{}', before '{}': different parts have different parameters. Take "
                      "one part number at a time "
                      "(`clampctl results --part-number`)",
                      place, part, *part_number_));
    values_.clear();
    for (const Columns::Parameter& parameter : columns.parameters) {
      if (cells_[parameter.value].empty() || cells_[parameter.deviation].empty())
        return ++table_.incomplete, Result<void>{};
      double value = 0.0, deviation = 0.0;
      if (!read_number(cells_[parameter.value], value))
        return failure(
            fmt::format("{}:{}: '{}' is not a number", place, parameter.value + 1, cells_[parameter.value]));
      if (!read_number(cells_[parameter.deviation], deviation) || deviation < 0.0)
        return failure(fmt::format("{}:{}: '{}' is no standard deviation", place, parameter.deviation + 1,
                                   cells_[parameter.deviation]));
      values_.emplace_back(value, deviation);
    }
    if (columns.record != kAbsent && !records_
                                          .insert(std::hash<std::string_view>{}(cell(columns.record)) ^
                                                  std::hash<std::string_view>{}(cell(columns.station)) * 31U)
                                          .second)
      return ++table_.doubled, Result<void>{};
    add(columns, cell, started);
    return {};
  }

  template <class Cell>
  void add(const Columns& columns, const Cell& cell, double started) {
    Layout& layout = table_.layout;
    const std::string_view station = cell(columns.station), fixture = cell(columns.fixture),
                           batch = cell(columns.batch);
    layout.brake.push_back(brakes_.number(cell(columns.serial)));
    layout.station.push_back(stations_.number(station));
    layout.fixture.push_back(
        fixtures_.number(fmt::format("{} / {}", station, fixture.empty() ? "-" : fixture)));
    layout.batch.push_back(batch.empty() ? -1 : batches_.number(batch));
    started_.push_back(started);
    simulated_.push_back(cell(columns.simulated) == "1");
    for (std::size_t i = 0; i < columns.parameters.size(); ++i) {
      ParameterReadings& readings = table_.parameters[columns.parameters[i].number];
      readings.values.push_back(values_[i].first);
      readings.deviations.push_back(values_[i].second);
    }
  }

  /// As the statistics of one station do: simulated brakes count where there are no others.
  void leave_out_simulated() {
    const auto count = static_cast<std::size_t>(std::count(simulated_.begin(), simulated_.end(), true));
    if (count == 0 || count == simulated_.size()) return;
    table_.simulated = count;
    const auto keep_real = [&](auto& values) {
      std::size_t kept = 0;
      for (std::size_t i = 0; i < values.size(); ++i)
        if (!simulated_[i]) values[kept++] = values[i];
      values.resize(kept);
    };
    Layout& layout = table_.layout;
    for (auto* levels : {&layout.brake, &layout.batch, &layout.station, &layout.fixture}) keep_real(*levels);
    for (ParameterReadings& parameter : table_.parameters) {
      keep_real(parameter.values);
      keep_real(parameter.deviations);
    }
    keep_real(started_);
  }

  /// Numbers without gaps, in the order of the old ones; the old number of each.
  static std::vector<std::int32_t> renumber(std::vector<std::int32_t>& levels, int& count) {
    std::vector<std::int32_t> old(levels);
    std::sort(old.begin(), old.end());
    old.erase(std::unique(old.begin(), old.end()), old.end());
    if (!old.empty() && old.front() < 0) old.erase(old.begin());
    for (std::int32_t& level : levels)
      if (level >= 0)
        level = static_cast<std::int32_t>(std::lower_bound(old.begin(), old.end(), level) - old.begin());
    count = static_cast<int>(old.size());
    return old;
  }

  static std::vector<std::string> keep_used(std::vector<std::int32_t>& levels,
                                            const std::vector<std::string>& names, int& count) {
    std::vector<std::string> used;
    for (const std::int32_t old : renumber(levels, count))
      used.push_back(names[static_cast<std::size_t>(old)]);
    return used;
  }

  void divide_time() {
    const auto [first, last] = std::minmax_element(started_.begin(), started_.end());
    table_.first_s = *first;
    table_.last_s = *last;
    Layout& layout = table_.layout;
    layout.periods = table_.last_s > table_.first_s ? periods_of(started_.size(), layout.stations) : 1;
    for (const double started : started_) {
      const double share =
          layout.periods == 1 ? 0.0 : (started - table_.first_s) / (table_.last_s - table_.first_s);
      layout.period.push_back(std::min(layout.periods - 1, static_cast<int>(share * layout.periods)));
    }
  }

  LineTable table_;
  Names brakes_, stations_, fixtures_, batches_;
  std::unordered_set<std::size_t> records_;
  std::optional<std::string> part_number_;  ///< of all checks
  std::vector<double> started_;
  std::vector<bool> simulated_;
  std::vector<std::string_view> cells_;
  std::vector<std::pair<double, double>> values_;
  int files_ = 0;
};

}  // namespace

int periods_of(std::size_t checks, int stations) {
  const auto by_checks = static_cast<int>(
      std::min<std::size_t>(kMostPeriods, checks / (kChecksInCell * static_cast<std::size_t>(stations))));
  const int by_cells = std::clamp(kMostCells / stations, kFewestPeriods, kMostPeriods);
  const int periods = std::min(by_checks, by_cells);
  return periods >= 3 ? periods : 1;
}

Result<LineTable> read_line_table(const std::vector<std::string>& files, std::size_t least) {
  TableOfFiles table;
  for (const std::string& file : files)
    if (const Result<void> done = table.read(file); !done) return tl::unexpected(done.error());
  return table.finish(least);
}

}  // namespace clampd::attribution
