#include "clampd/base/table_reader.hpp"

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <numeric>

#include <fmt/format.h>

namespace clampd {
namespace {

/// Insertions, deletions and replacements between both, upper and lower case being the same.
std::size_t edit_distance(std::string_view a, std::string_view b) {
  const auto same = [](char x, char y) {
    return std::tolower(static_cast<unsigned char>(x)) == std::tolower(static_cast<unsigned char>(y));
  };
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({above + 1, row[j - 1] + 1, diagonal + (same(a[i - 1], b[j - 1]) ? 0 : 1)});
      diagonal = above;
    }
  }
  return row[b.size()];
}

/// Nothing if it is none, or a whole number that is not exact as a double.
std::optional<double> finite_number(const toml::node& node) {
  const std::optional<double> value = node.is_number() ? node.value<double>() : std::nullopt;
  return value && std::isfinite(*value) ? value : std::nullopt;
}

}  // namespace

std::string toml_message(const std::string& file, const toml::source_region& where,
                         std::string_view message) {
  return fmt::format("{}:{}:{}: {}", file, where.begin.line, where.begin.column, message);
}

Result<toml::table> parse_toml(const std::string& text, const std::string& file) {
  try {
    return toml::parse(text, file);
  } catch (const toml::parse_error& error) {
    return failure(
        toml_message(file, error.source(), fmt::format("not valid TOML: {}", error.description())));
  }
}

bool is_date(std::string_view text) {
  int year = 0;
  unsigned month = 0;
  unsigned day = 0;
  int used = 0;
  const std::string copy(text);
  if (copy.size() != 10 || std::sscanf(copy.c_str(), "%4d-%2u-%2u%n", &year, &month, &day, &used) != 3 ||
      used != 10)
    return false;
  return std::chrono::year_month_day(std::chrono::year(year), std::chrono::month(month),
                                     std::chrono::day(day))
      .ok();
}

std::string TableReader::name(std::string_view key) const {
  return section_.empty() ? std::string(key) : fmt::format("{}.{}", section_, key);
}

void TableReader::refuse(const toml::source_region& where, std::string_view message) {
  if (!error_) error_ = Error{toml_message(file_, where, message)};
}

void TableReader::refuse(std::string_view key, std::string_view message) {
  const toml::node* node = table_.get(key);
  refuse(node == nullptr ? table_.source() : node->source(), message);
}

const toml::node* TableReader::at(std::string_view key) {
  if (std::ranges::find(known_, key) == known_.end()) known_.emplace_back(key);
  return error_ ? nullptr : table_.get(key);
}

void TableReader::number(std::string_view key, double& target, double least, double most) {
  const toml::node* node = at(key);
  if (node == nullptr) return;
  if (!node->is_number()) return refuse(node->source(), fmt::format("{} must be a number", name(key)));
  // Whole numbers beyond 2^53 are no doubles, and toml++ gives nothing for them.
  const std::optional<double> exact = node->value<double>();
  if (!exact)
    return refuse(node->source(),
                  fmt::format("{} = {} is too large to be exact; at most 2^53 = 9007199254740992", name(key),
                              **node->as_integer()));
  const double value = *exact;
  if (!std::isfinite(value) || value < least || value > most)
    return refuse(node->source(),
                  fmt::format("{} = {} is outside of {} to {}", name(key), value, least, most));
  target = value;
}

void TableReader::number(std::string_view key, double& target) {
  const toml::node* node = at(key);
  if (node == nullptr) return;
  if (const std::optional<double> value = finite_number(*node)) {
    target = *value;
    return;
  }
  refuse(node->source(), fmt::format("{} must be a finite number", name(key)));
}

void TableReader::numbers(std::string_view key, std::vector<double>& target) {
  if (const toml::node* node = at(key)) read_numbers(key, *node, target);
}

void TableReader::rows_of_numbers(std::string_view key, std::vector<std::vector<double>>& target) {
  const toml::node* node = at(key);
  if (node == nullptr) return;
  if (!node->is_array())
    return refuse(node->source(), fmt::format("{} must be a list of lists of numbers", name(key)));
  target.clear();
  for (const toml::node& row : *node->as_array()) read_numbers(key, row, target.emplace_back());
}

void TableReader::read_numbers(std::string_view key, const toml::node& node, std::vector<double>& target) {
  const toml::array* array = node.as_array();
  if (array == nullptr) return refuse(node.source(), fmt::format("{} must be a list of numbers", name(key)));
  target.clear();
  for (const toml::node& entry : *array) {
    const std::optional<double> value = finite_number(entry);
    if (!value) return refuse(entry.source(), fmt::format("{} must hold finite numbers only", name(key)));
    target.push_back(*value);
  }
}

bool TableReader::read_integer(std::string_view key, std::int64_t& value, std::int64_t least,
                               std::int64_t most) {
  const toml::node* node = at(key);
  if (node == nullptr) return false;
  if (!node->is_integer()) {
    refuse(node->source(), fmt::format("{} must be a whole number", name(key)));
    return false;
  }
  value = **node->as_integer();
  if (value >= least && value <= most) return true;
  refuse(node->source(), fmt::format("{} = {} is outside of {} to {}", name(key), value, least, most));
  return false;
}

void TableReader::boolean(std::string_view key, bool& target) {
  const toml::node* node = at(key);
  if (node == nullptr) return;
  if (!node->is_boolean()) return refuse(node->source(), fmt::format("{} must be true or false", name(key)));
  target = **node->as_boolean();
}

void TableReader::text(std::string_view key, std::string& target, std::size_t longest) {
  const toml::node* node = at(key);
  if (node == nullptr) return;
  if (!node->is_string())
    return refuse(node->source(), fmt::format("{} must be a text in quotes", name(key)));
  const std::string& value = **node->as_string();
  if (value.size() > longest)
    return refuse(node->source(), fmt::format("{} is longer than {} characters", name(key), longest));
  if (std::any_of(value.begin(), value.end(),
                  [](char c) { return static_cast<unsigned char>(c) < 0x20 || c == 0x7f; }))
    return refuse(node->source(), fmt::format("{} contains control characters", name(key)));
  target = value;
}

void TableReader::choice(std::string_view key, std::string& target,
                         std::initializer_list<std::string_view> choices) {
  const toml::node* node = at(key);
  if (node == nullptr) return;
  if (node->is_string() && std::find(choices.begin(), choices.end(), **node->as_string()) != choices.end()) {
    target = **node->as_string();
    return;
  }
  refuse(node->source(), fmt::format("{} must be one of \"{}\"", name(key), fmt::join(choices, "\", \"")));
}

void TableReader::texts(std::string_view key, std::vector<std::string>& target) {
  const toml::node* node = at(key);
  if (node == nullptr) return;
  const toml::array* array = node->as_array();
  if (array == nullptr || !(array->empty() || array->is_homogeneous<std::string>()))
    return refuse(node->source(), fmt::format("{} must be a list of texts in quotes", name(key)));
  target.clear();
  for (const toml::node& entry : *array) target.push_back(**entry.as_string());
}

void TableReader::date(std::string_view key, std::string& target) {
  const toml::node* node = at(key);
  if (node == nullptr) return;
  std::string value;
  if (const auto* date_node = node->as_date()) {
    value = fmt::format("{:04}-{:02}-{:02}", (*date_node)->year, (*date_node)->month, (*date_node)->day);
  } else if (const auto* text_node = node->as_string()) {
    value = **text_node;
  }
  if (!is_date(value)) return refuse(node->source(), fmt::format("{} must be a date YYYY-MM-DD", name(key)));
  target = value;
}

namespace {

std::string in_folder(const std::string& value, const std::string& folder) {
  return value.empty() || std::filesystem::path(value).is_absolute()
             ? value
             : (std::filesystem::path(folder) / value).lexically_normal().string();
}

}  // namespace

void TableReader::path(std::string_view key, std::string& target, const std::string& folder) {
  std::string value;
  text(key, value, 4000);
  if (error_ || !has(key)) return;
  target = in_folder(value, folder);
}

void TableReader::paths(std::string_view key, std::optional<std::vector<std::string>>& target,
                        const std::string& folder) {
  std::vector<std::string> values;
  texts(key, values);
  if (error_ || !has(key)) return;
  for (std::string& value : values) {
    if (value.empty()) return refuse(at(key)->source(), fmt::format("{} names a file with no name", name(key)));
    value = in_folder(value, folder);
  }
  target = std::move(values);
}

const toml::table* TableReader::table(std::string_view key) {
  const toml::node* node = at(key);
  if (node == nullptr) return nullptr;
  if (!node->is_table()) refuse(node->source(), fmt::format("{} must be a table", name(key)));
  return node->as_table();
}

const toml::array* TableReader::array_of_tables(std::string_view key) {
  const toml::node* node = at(key);
  if (node == nullptr) return nullptr;
  if (!node->is_array_of_tables()) {
    refuse(node->source(), fmt::format("{0} must be written as [[{0}]]", name(key)));
    return nullptr;
  }
  return node->as_array();
}

void TableReader::finish() {
  if (error_) return;
  for (const auto& [key, node] : table_) {
    const std::string_view found = key.str();
    if (std::find(known_.begin(), known_.end(), found) != known_.end()) continue;
    const auto distance = [&](const std::string& known) { return edit_distance(found, known); };
    const auto nearest = std::min_element(known_.begin(), known_.end(), [&](const auto& a, const auto& b) {
      return distance(a) < distance(b);
    });
    std::string message = section_.empty() ? fmt::format("unknown key {}", found)
                                           : fmt::format("unknown key {} in [{}]", found, section_);
    if (nearest != known_.end()) {
      message += distance(*nearest) <= std::max<std::size_t>(2, found.size() / 3)
                     ? fmt::format("; did you mean {}?", *nearest)
                     : fmt::format("; known are {}", fmt::join(known_, ", "));
    }
    return refuse(key.source(), message);
  }
}

}  // namespace clampd
