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

#include "clampd/base/assert.hpp"

namespace clampd::attribution {
namespace {

/// Cells of stations and periods together: a likelihood costs their third power.
constexpr int kMostCells = 400;
constexpr int kFewestPeriods = 4;
constexpr int kMostPeriods = 24;
/// A period of a station shall have so many checks on average.
constexpr std::size_t kChecksInCell = 5;

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

  Result<LineTable> finish(std::size_t least) { return builder_.finish(part_number_.value_or(""), least); }

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
      const std::vector<ParameterReadings>& parameters = builder_.table().parameters;
      const auto known = std::find_if(parameters.begin(), parameters.end(),
                                      [&](const auto& p) { return p.name == name; });
      if (known != parameters.end() && known->unit != unit)
        return failure(
            fmt::format("{}:1: {} is in {} here and in {} in another file", file, name, unit, known->unit));
      if (known == parameters.end() && files_ > 0)
        return failure(fmt::format("{}:1: has the parameter {}, which other files do not have", file, name));
      const std::size_t number = known == parameters.end()
                                     ? builder_.add_parameter(name, unit)
                                     : static_cast<std::size_t>(known - parameters.begin());
      columns.parameters.push_back({number, i, deviation});
    }
    const std::size_t needed = builder_.table().parameters.size();
    if (columns.parameters.size() != needed || columns.parameters.empty())
      return failure(
          fmt::format("{}:1: has {} parameters with a standard deviation (columns NAME [unit] and NAME sd "
                      "[unit]), {} are needed",
                      file, columns.parameters.size(), std::max<std::size_t>(1, needed)));
    ++files_;
    return {};
  }

  Result<void> take(const Columns& columns, const std::string& place) {
    const auto cell = [&](std::size_t column) {
      return column == kAbsent ? std::string_view() : cells_[column];
    };
    if (!cell(columns.voided).empty()) return builder_.leave_out(&LineTable::voided), Result<void>{};
    if (cell(columns.verdict) != "PASS" && cell(columns.verdict) != "FAIL")
      return builder_.leave_out(&LineTable::invalid), Result<void>{};
    if (cell(columns.serial).empty() || cell(columns.station).empty() || cell(columns.started).empty())
      return builder_.leave_out(&LineTable::incomplete), Result<void>{};
    LineCheck check;
    if (!read_time(cell(columns.started), check.started_s))
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
    readings_.assign(columns.parameters.size(), {});
    for (const Columns::Parameter& parameter : columns.parameters) {
      if (cells_[parameter.value].empty() || cells_[parameter.deviation].empty())
        return builder_.leave_out(&LineTable::incomplete), Result<void>{};
      auto& [value, deviation] = readings_[parameter.number];
      if (!read_number(cells_[parameter.value], value))
        return failure(
            fmt::format("{}:{}: '{}' is not a number", place, parameter.value + 1, cells_[parameter.value]));
      if (!read_number(cells_[parameter.deviation], deviation) || deviation < 0.0)
        return failure(fmt::format("{}:{}: '{}' is no standard deviation", place, parameter.deviation + 1,
                                   cells_[parameter.deviation]));
    }
    check.record = cell(columns.record);
    check.serial = cell(columns.serial);
    check.batch = cell(columns.batch);
    check.station = cell(columns.station);
    check.fixture = cell(columns.fixture);
    check.simulated = cell(columns.simulated) == "1";
    check.readings = readings_;
    builder_.add(check);
    return {};
  }

  LineTableBuilder builder_;
  std::optional<std::string> part_number_;  ///< of all checks
  std::vector<std::string_view> cells_;
  std::vector<std::pair<double, double>> readings_;
  int files_ = 0;
};

/// Numbers without gaps, in the order of the old ones; the old number of each.
std::vector<std::int32_t> renumber(std::vector<std::int32_t>& levels, int& count) {
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

std::vector<std::string> keep_used(std::vector<std::int32_t>& levels, const std::vector<std::string>& names,
                                   int& count) {
  std::vector<std::string> used;
  for (const std::int32_t old : renumber(levels, count)) used.push_back(names[static_cast<std::size_t>(old)]);
  return used;
}

}  // namespace

/// Names as numbers, in the order of their appearance.
class LineTableBuilder::Names {
 public:
  std::int32_t number(std::string_view name) {
    return numbers_.try_emplace(std::string(name), static_cast<std::int32_t>(numbers_.size())).first->second;
  }
  std::vector<std::string> all() const {
    std::vector<std::string> names(numbers_.size());
    for (const auto& [name, number] : numbers_) names[static_cast<std::size_t>(number)] = name;
    return names;
  }

 private:
  std::unordered_map<std::string, std::int32_t> numbers_;
};

struct LineTableBuilder::Seen {
  Names brakes, stations, fixtures, batches;
  std::unordered_set<std::size_t> records;
  std::vector<bool> simulated;
};

LineTableBuilder::LineTableBuilder() : seen_(std::make_unique<Seen>()) {}
LineTableBuilder::~LineTableBuilder() = default;

std::size_t LineTableBuilder::add_parameter(const std::string& name, const std::string& unit) {
  table_.parameters.push_back({name, unit, {}, {}});
  return table_.parameters.size() - 1;
}

void LineTableBuilder::leave_out(std::size_t LineTable::*why) {
  ++table_.rows;
  ++(table_.*why);
}

void LineTableBuilder::add(const LineCheck& check) {
  CLAMPD_ASSERT(check.readings.size() == table_.parameters.size());
  ++table_.rows;
  const std::hash<std::string_view> hash;
  if (!check.record.empty() && !seen_->records.insert(hash(check.record) ^ hash(check.station) * 31U).second) {
    ++table_.doubled;
    return;
  }
  Layout& layout = table_.layout;
  layout.brake.push_back(seen_->brakes.number(check.serial));
  layout.station.push_back(seen_->stations.number(check.station));
  layout.fixture.push_back(seen_->fixtures.number(
      fmt::format("{} / {}", check.station, check.fixture.empty() ? "-" : check.fixture)));
  layout.batch.push_back(check.batch.empty() ? -1 : seen_->batches.number(check.batch));
  table_.started_s.push_back(check.started_s);
  seen_->simulated.push_back(check.simulated);
  for (std::size_t i = 0; i < check.readings.size(); ++i) {
    table_.parameters[i].values.push_back(check.readings[i].first);
    table_.parameters[i].deviations.push_back(check.readings[i].second);
  }
}

Result<LineTable> LineTableBuilder::finish(std::string part_number, std::size_t least) {
  leave_out_simulated();
  if (table_.checks() < least)
    return failure(fmt::format(
        "{} of {} rows are valid checks: too few ({} neither PASS nor FAIL, {} void, "
        "{} incomplete)",
        table_.checks(), table_.rows, table_.invalid, table_.voided, table_.incomplete));
  Layout& layout = table_.layout;
  table_.brakes = keep_used(layout.brake, seen_->brakes.all(), layout.brakes);
  table_.part_number = std::move(part_number);
  table_.stations = keep_used(layout.station, seen_->stations.all(), layout.stations);
  table_.fixtures = keep_used(layout.fixture, seen_->fixtures.all(), layout.fixtures);
  table_.batches = keep_used(layout.batch, seen_->batches.all(), layout.batches);
  if (table_.checks() > 0) divide_time();
  return std::move(table_);
}

/// As the statistics of one station do: simulated brakes count where there are no others.
void LineTableBuilder::leave_out_simulated() {
  const std::vector<bool>& simulated = seen_->simulated;
  const auto count = static_cast<std::size_t>(std::count(simulated.begin(), simulated.end(), true));
  if (count == 0 || count == simulated.size()) return;
  table_.simulated = count;
  const auto keep_real = [&](auto& values) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < values.size(); ++i)
      if (!simulated[i]) values[kept++] = values[i];
    values.resize(kept);
  };
  Layout& layout = table_.layout;
  for (auto* levels : {&layout.brake, &layout.batch, &layout.station, &layout.fixture}) keep_real(*levels);
  for (ParameterReadings& parameter : table_.parameters) {
    keep_real(parameter.values);
    keep_real(parameter.deviations);
  }
  keep_real(table_.started_s);
}

void LineTableBuilder::divide_time() {
  const auto [first, last] = std::minmax_element(table_.started_s.begin(), table_.started_s.end());
  table_.first_s = *first;
  table_.last_s = *last;
  Layout& layout = table_.layout;
  layout.periods =
      table_.last_s > table_.first_s ? periods_of(table_.started_s.size(), layout.stations) : 1;
  for (const double started : table_.started_s) {
    const double share =
        layout.periods == 1 ? 0.0 : (started - table_.first_s) / (table_.last_s - table_.first_s);
    layout.period.push_back(std::min(layout.periods - 1, static_cast<int>(share * layout.periods)));
  }
}

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
