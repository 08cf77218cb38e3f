#include "clampd/record/run.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <iterator>
#include <optional>
#include <span>
#include <string_view>

#include <fmt/format.h>

#include "clampd/record/file.hpp"

namespace clampd {
namespace {

struct Column {
  std::string_view name;
  std::vector<double> Run::*values;
  bool required;
  double scale = 1.0;
  double wrap = 0.0;
  double offset = 0.0;
  std::string_view minus = {};
  int other = -1;  ///< index in Run::others instead of `values`
  std::string_view label = {};  ///< its name there
  double late_s = 0.0;
};

std::vector<double>& values_of(Run& run, const Column& column) {
  return column.other < 0 ? run.*column.values : run.others[static_cast<std::size_t>(column.other)].values;
}

constexpr std::array<Column, 6> kColumns{{
    {"time_s", &Run::time_s, true},
    {"torque_Nm", &Run::torque_Nm, true},
    {"velocity_rad_s", &Run::velocity_rad_s, true},
    {"force_N", &Run::force_N, true},
    {"position_rad", &Run::position_rad, false},
    {"drive_enabled", &Run::drive_enabled, false},
}};

struct Field {
  std::string_view text;   ///< trimmed, without quotes
  std::size_t column = 1;  ///< 1-based character in its line
};

std::string_view trim(std::string_view text) {
  constexpr std::string_view kBlank = " \t\r";
  const std::size_t first = text.find_first_not_of(kBlank);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlank) - first + 1);
}

/// What a message can show of a text that may be long or binary.
std::string shown(std::string_view text) {
  constexpr std::size_t kLongest = 40;
  std::string result;
  for (const char c : text.substr(0, kLongest))
    result += static_cast<unsigned char>(c) < 0x20 || c == 0x7f ? '?' : c;
  if (text.size() > kLongest) result += "...";
  return result;
}

void split(std::string_view line, char separator, std::vector<Field>& fields) {
  fields.clear();
  std::size_t start = 0;
  while (true) {
    const std::size_t end = line.find(separator, start);
    const std::string_view raw = line.substr(start, end == std::string_view::npos ? end : end - start);
    std::string_view text = trim(raw);
    Field field;
    field.column = 1 + (text.empty() ? start : static_cast<std::size_t>(text.data() - line.data()));
    if (text.size() >= 2 && text.front() == '"' && text.back() == '"')
      text = trim(text.substr(1, text.size() - 2));
    field.text = text;
    fields.push_back(field);
    if (end == std::string_view::npos) return;
    start = end + 1;
  }
}

std::optional<double> parse_number(std::string_view text) {
  if (text.size() > 1 && text.front() == '+' && text[1] != '-') text.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

/// The same where columns are not separated by commas, so that one may stand for the decimal point.
std::optional<double> parse_number(std::string_view text, char separator) {
  const std::size_t comma = separator == ',' ? std::string_view::npos : text.find(',');
  if (comma == std::string_view::npos) return parse_number(text);
  if (text.find('.') != std::string_view::npos) return std::nullopt;  // "1,234.5" could be either
  std::string with_point(text);
  with_point[comma] = '.';
  return parse_number(with_point);
}

/// Loggers and spreadsheets write commas, semicolons where the comma is the decimal point, or tabs.
char separator_of(std::string_view header) {
  for (const char each : {';', '\t'})
    if (header.find(each) != std::string_view::npos) return each;
  return ',';
}

class LineReader {
 public:
  explicit LineReader(std::string_view text) : rest_(text) {
    if (rest_.substr(0, 3) == "\xEF\xBB\xBF") rest_.remove_prefix(3);
    while (!rest_.empty() && (trim(rest_.substr(rest_.size() - 1)).empty() || rest_.back() == '\n'))
      rest_.remove_suffix(1);  // blank lines at the end
  }

  bool next(std::string_view& line) {
    if (rest_.empty()) return false;
    const std::size_t end = rest_.find('\n');
    line = rest_.substr(0, end);
    rest_.remove_prefix(end == std::string_view::npos ? rest_.size() : end + 1);
    ++number_;
    return true;
  }

  std::size_t number() const { return number_; }

 private:
  std::string_view rest_;
  std::size_t number_ = 0;
};

void append_number(std::string& text, double value) {
  std::array<char, 32> buffer;  // the shortest form that reads back the same never needs more than 24
  const auto [end, error] = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value);
  static_cast<void>(error);
  text.append(buffer.data(), end);
}

/// Readings that start again after `wrap` go on instead: no step is longer than half of it.
void unwrap(std::vector<double>& values, double wrap) {
  double turns = 0.0;
  double last = values.empty() ? 0.0 : values.front();
  for (double& value : values) {
    turns -= std::round((value - last) / wrap);
    last = value;
    value += turns * wrap;
  }
}

/// Where a column of a file goes: into its own quantity, and into those from which it is subtracted.
struct Target {
  std::vector<double>* values = nullptr;
  std::vector<double>* subtracted = nullptr;
};

std::string ignored_columns(const std::string& name, const std::vector<Field>& header, const std::vector<Target>& targets, bool foreign,
                            std::vector<std::string>& notices) {
  std::string all;
  for (std::size_t i = 0; i < header.size(); ++i) {
    if (targets[i].values != nullptr || targets[i].subtracted != nullptr) continue;
    if (!foreign)
      notices.push_back(fmt::format("{}:1:{}: column \"{}\" is ignored", name, header[i].column, shown(header[i].text)));
    all += fmt::format("{}\"{}\"", all.empty() ? "" : ", ", shown(header[i].text));
  }
  return all;
}

/// Unwraps, subtracts, scales and shifts what has been read.
Result<void> convert(const Column& column, Run& run, std::vector<double>& subtracted, std::size_t header_lines) {
  if (column.wrap == 0.0 && column.scale == 1.0 && column.offset == 0.0 && column.minus.empty()) return {};
  std::vector<double>& values = values_of(run, column);
  if (column.wrap > 0.0) unwrap(values, column.wrap);
  for (std::size_t row = 0; row < values.size(); ++row) {
    if (!subtracted.empty()) values[row] -= subtracted[row];
    values[row] = values[row] * column.scale + column.offset;
    // In other units a number may be too large, or two times the same.
    if (!std::isfinite(values[row]))
      return failure(fmt::format("{}:{}:1: {} is not a finite number in SI units", run.name, row + 1 + header_lines, column.name));
    if (column.values == &Run::time_s && column.other < 0 && row > 0 && values[row] <= values[row - 1])
      return failure(fmt::format("{}:{}:1: {} does not increase in SI units", run.name, row + 1 + header_lines, column.name));
  }
  return {};
}

/// Straight lines between the rows.
double interpolated(const std::vector<double>& times, const std::vector<double>& values, double at) {
  const auto next = std::ranges::lower_bound(times, at);
  if (next == times.begin()) return values.front();
  if (next == times.end()) return values.back();
  const auto i = static_cast<std::size_t>(next - times.begin());
  return values[i - 1] + (values[i] - values[i - 1]) * (at - times[i - 1]) / (times[i] - times[i - 1]);
}

/// Moves what was read late to where it belongs, and leaves out the rows at the ends for which it was not read.
Result<void> take_out_delays(Run& run, std::span<const Column> columns) {
  double earliest_s = 0.0, latest_s = 0.0;
  for (const Column& column : columns) {
    earliest_s = std::min(earliest_s, column.late_s);
    latest_s = std::max(latest_s, column.late_s);
  }
  if (earliest_s == 0.0 && latest_s == 0.0) return {};
  const std::vector<double> times = run.time_s;
  const auto first = std::ranges::lower_bound(times, times.front() - earliest_s) - times.begin();
  const auto last = std::ranges::upper_bound(times, times.back() - latest_s) - times.begin();
  if (last <= first)
    return failure(fmt::format("{}: with the delays of the model file, late_s, no row has all readings; the file lasts {:.3g} s",
                               run.name, times.back() - times.front()));
  for (const Column& column : columns) {
    std::vector<double>& values = values_of(run, column);
    if (values.empty()) continue;
    std::vector<double> kept;
    for (auto i = first; i < last; ++i) {
      const auto row = static_cast<std::size_t>(i);
      kept.push_back(column.late_s == 0.0 ? values[row] : interpolated(times, values, times[row] + column.late_s));
    }
    values = std::move(kept);
  }
  return {};
}

/// Where in a file something is wrong.
struct Place {
  const std::string& file;
  const LineReader& lines;

  auto fails(std::size_t column, std::string_view message) const {
    return failure(fmt::format("{}:{}:{}: {}", file, lines.number(), column, message));
  }
};

/// What each field of the header is read into.
struct Targets {
  std::vector<Target> of_field;
  std::vector<std::vector<double>> subtracted;  ///< one for each column; those that of_field points to
};

Result<std::size_t> field_called(std::string_view wanted, const std::vector<Field>& header, const Place& place) {
  std::size_t found = header.size();
  for (std::size_t i = 0; i < header.size(); ++i) {
    if (header[i].text != wanted) continue;
    if (found != header.size()) return place.fails(header[i].column, fmt::format("column {} appears twice", wanted));
    found = i;
  }
  return found;
}

Result<Targets> targets_in(Run& run, std::span<const Column> columns, const std::vector<Field>& header, std::string_view line,
                           const Place& place) {
  Targets targets{std::vector<Target>(header.size()), std::vector<std::vector<double>>(columns.size())};
  for (std::size_t c = 0; c < columns.size(); ++c) {
    const Column& column = columns[c];
    for (const bool minus : {false, true}) {
      const std::string_view wanted = minus ? column.minus : column.name;
      if (minus && wanted.empty()) continue;
      const Result<std::size_t> found = field_called(wanted, header, place);
      if (!found) return tl::unexpected(found.error());
      if (*found != header.size()) {
        Target& field = targets.of_field[*found];
        std::vector<double>*& target = minus ? field.subtracted : field.values;
        if (target != nullptr) return place.fails(header[*found].column, fmt::format("column {} is used twice", wanted));
        target = minus ? &targets.subtracted[c] : &values_of(run, column);
      } else if (column.required) {
        return place.fails(1, fmt::format("column {} is missing; the header is \"{}\"", wanted, shown(trim(line))));
      }
    }
  }
  return targets;
}

Result<void> read_row(const std::vector<Field>& fields, char separator, const std::vector<Field>& header, const Targets& targets,
                      Run& run, const Place& place) {
  for (std::size_t i = 0; i < fields.size(); ++i) {
    const Target& target = targets.of_field[i];
    if (target.values == nullptr && target.subtracted == nullptr) continue;
    const std::optional<double> value = parse_number(fields[i].text, separator);
    if (!value)
      return place.fails(fields[i].column, fmt::format("{} is not a finite number: \"{}\"", header[i].text, shown(fields[i].text)));
    if (target.values == &run.time_s && !run.time_s.empty() && *value <= run.time_s.back())
      return place.fails(fields[i].column, fmt::format("{} does not increase: {} after {}", header[i].text, *value, run.time_s.back()));
    if (target.values == &run.drive_enabled && *value != 0.0 && *value != 1.0)
      return place.fails(fields[i].column,
                         fmt::format("{} is {}; it must be 1, or 0 where the drive was off", header[i].text, *value));
    if (target.values != nullptr) target.values->push_back(*value);
    if (target.subtracted != nullptr) target.subtracted->push_back(*value);
  }
  return {};
}

/// `foreign`: a file of somebody else's, which may begin with lines of its own and has comments.
Result<LoadedRun> parse_columns(const std::string& text, const std::string& name, std::span<const Column> columns,
                                bool foreign = false, int skip_lines = 0) {
  LineReader lines(text);
  const Place place{name, lines};
  std::string_view line;
  const auto next = [&] {
    while (lines.next(line))
      if (!foreign || !trim(line).starts_with('#')) return true;
    return false;
  };
  while (skip_lines-- > 0 && lines.next(line)) {
  }
  if (!next()) {
    std::string expected;
    for (const Column& column : columns)
      if (column.required) expected += (expected.empty() ? "" : ",") + std::string(column.name);
    return failure(fmt::format("{}:1:1: the file is empty; expected a header with {}", name, expected));
  }
  const std::size_t header_lines = lines.number();
  std::vector<Field> header;
  const char separator = foreign ? separator_of(line) : ',';
  split(line, separator, header);
  if (header.size() == 1 && line.find_first_of(";\t") != std::string_view::npos)
    return place.fails(1 + line.find_first_of(";\t"), "columns must be separated by commas");

  LoadedRun loaded;
  loaded.run.name = name;
  for (const Column& column : columns)
    if (column.other >= 0) loaded.run.others.push_back({std::string(column.name), {}});
  Result<Targets> targets = targets_in(loaded.run, columns, header, line, place);
  if (!targets) return tl::unexpected(targets.error());
  const std::string ignored = ignored_columns(name, header, targets->of_field, foreign, loaded.notices);
  if (foreign && !ignored.empty())
    loaded.notices.push_back(fmt::format("{}: column{} {} ignored", name, ignored.find(", ") == std::string::npos ? "" : "s",
                                         ignored + (ignored.find(", ") == std::string::npos ? " is" : " are")));

  std::vector<Field> fields;
  fields.reserve(header.size());
  while (next()) {
    if (trim(line).empty()) return place.fails(1, "an empty line between rows");
    split(line, separator, fields);
    if (fields.size() != header.size())
      return place.fails(fields.size() > header.size() ? fields[header.size()].column : line.size() + 1,
                         fmt::format("the row has {} fields, the header {}", fields.size(), header.size()));
    if (const Result<void> read = read_row(fields, separator, header, *targets, loaded.run, place); !read) return tl::unexpected(read.error());
  }
  if (loaded.run.size() == 0)
    return failure(fmt::format("{}:{}:1: the file has a header and no rows", name, lines.number() + 1));
  for (std::size_t c = 0; c < columns.size(); ++c)
    if (const Result<void> converted = convert(columns[c], loaded.run, targets->subtracted[c], header_lines); !converted)
      return tl::unexpected(converted.error());
  if (const Result<void> shifted = take_out_delays(loaded.run, columns); !shifted) return tl::unexpected(shifted.error());
  for (std::size_t c = 0; c < columns.size(); ++c)  // by the names that the map gives them
    if (columns[c].other >= 0) loaded.run.others[static_cast<std::size_t>(columns[c].other)].name = columns[c].label;
  return loaded;
}

std::vector<Column> columns_of(const ColumnMap& map) {
  std::vector<Column> columns;
  const auto add = [&](const ColumnSource& source, std::vector<double> Run::*values) {
    columns.push_back({source.column, values, true, source.scale, source.wrap, source.offset, source.minus});
    columns.back().late_s = source.late_s;
  };
  add(map.time, &Run::time_s);
  if (map.torque) add(*map.torque, &Run::torque_Nm);
  if (map.velocity) add(*map.velocity, &Run::velocity_rad_s);
  if (map.position) add(*map.position, &Run::position_rad);
  if (map.force) add(*map.force, &Run::force_N);
  if (map.drive_enabled) add(*map.drive_enabled, &Run::drive_enabled);
  for (std::size_t i = 0; i < map.others.size(); ++i) {
    add(map.others[i].second, nullptr);
    columns.back().other = static_cast<int>(i);
    columns.back().label = map.others[i].first;
  }
  return columns;
}

}  // namespace

std::optional<TorqueWhileOff> torque_while_off(std::span<const Run> runs) {
  std::vector<double> readings;
  for (const Run& run : runs)
    for (std::size_t k = 0; k < run.drive_enabled.size(); ++k)
      if (run.drive_enabled[k] == 0.0) readings.push_back(run.torque_Nm[k]);
  constexpr std::size_t kBatches = 10;
  if (readings.size() < 2 * kBatches) return std::nullopt;
  // Some drives tell nothing while they are off, as often as one asks.
  if (std::ranges::count(readings, readings.front()) == std::ssize(readings)) return std::nullopt;
  TorqueWhileOff result{.rows = readings.size()};
  const auto count = static_cast<double>(readings.size());
  for (const double reading : readings) result.mean_Nm += reading / count;
  double squares = 0.0, batch_squares = 0.0;
  for (const double reading : readings) squares += (reading - result.mean_Nm) * (reading - result.mean_Nm);
  // What wanders is seen between batches and not between neighbours.
  for (std::size_t b = 0; b < kBatches; ++b) {
    const std::size_t begin = b * readings.size() / kBatches, end = (b + 1) * readings.size() / kBatches;
    double sum = 0.0;
    for (std::size_t k = begin; k < end; ++k) sum += readings[k] - result.mean_Nm;
    batch_squares += sum * sum / static_cast<double>((end - begin) * (end - begin));
  }
  constexpr auto kCount = static_cast<double>(kBatches);
  result.sd_Nm =
      std::sqrt(std::max(squares / (count * (count - 1.0)), batch_squares / (kCount * (kCount - 1.0))));
  return result;
}

std::optional<TorqueWhileOff> pooled(const std::optional<TorqueWhileOff>& a,
                                     const std::optional<TorqueWhileOff>& b) {
  if (!a || !b) return a ? a : b;
  const auto of_a = static_cast<double>(a->rows), of_b = static_cast<double>(b->rows);
  const double rows = of_a + of_b;
  return TorqueWhileOff{(of_a * a->mean_Nm + of_b * b->mean_Nm) / rows,
                        std::hypot(of_a * a->sd_Nm, of_b * b->sd_Nm) / rows, a->rows + b->rows};
}

bool is_driven(const Run& run) {
  return run.drive_enabled.empty() || std::ranges::count(run.drive_enabled, 1.0) > 0;
}

std::vector<Run> driven_runs(std::span<const Run> runs) {
  std::vector<Run> driven;
  std::ranges::copy_if(runs, std::back_inserter(driven), is_driven);
  return driven;
}

Result<TableHeader> find_header(const std::string& text, const std::string& name) {
  constexpr std::size_t kLeastColumns = 3;
  constexpr int kMostLines = 200;
  LineReader lines(text);
  std::string_view line;
  std::vector<Field> header, fields;
  TableHeader found;
  char separator = ',';
  bool only_comments = true;  // before this line
  while (lines.next(line) && lines.number() < kMostLines) {
    if (trim(line).starts_with('#')) continue;
    split(line, separator, fields);
    const auto is_number = [&](const Field& field) { return parse_number(field.text, separator).has_value(); };
    if (header.size() >= kLeastColumns && fields.size() == header.size() && std::ranges::all_of(fields, is_number)) {
      for (const Field& field : header) found.names.emplace_back(field.text);
      return found;
    }
    found.skip_lines = only_comments ? 0 : static_cast<int>(lines.number()) - 1;
    only_comments = false;
    separator = separator_of(line);
    split(line, separator, header);
  }
  return failure(fmt::format("{}: no line of three names or more is followed by a line with as many numbers. Columns are separated "
                             "by commas, semicolons or tabs, under one line of names",
                             name));
}

Result<LoadedRun> parse_run(const std::string& text, const std::string& name) {
  return parse_columns(text, name, kColumns);
}

Result<LoadedRun> parse_run(const std::string& text, const std::string& name, const ColumnMap& columns) {
  return parse_columns(text, name, columns_of(columns), true, columns.skip_lines);
}

Result<LoadedRun> read_run(const std::string& path) {
  return read_file(path).and_then([&](const std::string& text) { return parse_run(text, path); });
}

Result<LoadedRun> read_run(const std::string& path, const ColumnMap& columns) {
  return read_file(path).and_then([&](const std::string& text) { return parse_run(text, path, columns); });
}

std::string format_run(const Run& run) {
  std::string text = "time_s";
  std::vector<const std::vector<double>*> columns;
  const auto add = [&](std::string_view name, const std::vector<double>& values) {
    if (values.empty()) return;  // the motion of a drive has no force, and no torque before it is driven
    text += ',';
    text += name;
    columns.push_back(&values);
  };
  add("torque_Nm", run.torque_Nm);
  add("velocity_rad_s", run.velocity_rad_s);
  add("force_N", run.force_N);
  add("position_rad", run.position_rad);
  add("drive_enabled", run.drive_enabled);
  text += '\n';
  text.reserve(text.size() + run.size() * 90);
  for (std::size_t i = 0; i < run.size(); ++i) {
    append_number(text, run.time_s[i]);
    for (const std::vector<double>* values : columns) {
      text += ',';
      append_number(text, (*values)[i]);
    }
    text += '\n';
  }
  return text;
}

Result<void> write_run(const std::string& path, const Run& run) {
  return write_file_atomically(path, format_run(run));
}

}  // namespace clampd
