#pragma once

#include <cmath>
#include <concepts>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <toml++/toml.h>

#include "clampd/base/result.hpp"

namespace clampd {

/// Parses TOML text; `file` stands for it in messages.
Result<toml::table> parse_toml(const std::string& text, const std::string& file);

/// "file:line:column: message" for a place in a TOML document.
std::string toml_message(const std::string& file, const toml::source_region& where, std::string_view message);

/// Reads one table strictly: what is asked for is checked, and finish() refuses every key that nobody asked
/// for. The first error is kept, and everything after it leaves its target alone.
class TableReader {
 public:
  /// `section`: the table's name in messages, empty for the document itself. `error` outlives the reader.
  TableReader(const toml::table& table, std::string section, const std::string& file,
              std::optional<Error>& error)
      : table_(table), section_(std::move(section)), file_(file), error_(error) {}

  void number(std::string_view key, double& target, double least, double most);
  /// Any finite number.
  void number(std::string_view key, double& target);
  /// An array of finite numbers.
  void numbers(std::string_view key, std::vector<double>& target);
  /// An array of arrays of finite numbers.
  void rows_of_numbers(std::string_view key, std::vector<std::vector<double>>& target);
  void boolean(std::string_view key, bool& target);
  void text(std::string_view key, std::string& target, std::size_t longest = 200);
  /// One of the given texts.
  void choice(std::string_view key, std::string& target, std::initializer_list<std::string_view> choices);
  /// An array of texts.
  void texts(std::string_view key, std::vector<std::string>& target);
  /// An array of files; nothing is changed where the key is left out.
  void paths(std::string_view key, std::optional<std::vector<std::string>>& target, const std::string& folder);
  /// A TOML date or a string YYYY-MM-DD.
  void date(std::string_view key, std::string& target);
  /// Relative paths count from `folder`.
  void path(std::string_view key, std::string& target, const std::string& folder);

  template <std::integral T>
  void integer(std::string_view key, T& target, std::int64_t least, std::int64_t most) {
    std::int64_t value = 0;
    if (read_integer(key, value, least, most)) target = static_cast<T>(value);
  }

  /// Nothing if absent or an error.
  const toml::table* table(std::string_view key);
  const toml::array* array_of_tables(std::string_view key);
  /// What may be of several types: as it stands there.
  const toml::node* at(std::string_view key);
  bool has(std::string_view key) const { return table_.contains(key); }

  /// Refuses unknown keys, naming the nearest known one.
  void finish();

  /// Keeps the first error.
  void refuse(const toml::source_region& where, std::string_view message);
  /// At the key, or at the table if it lacks the key.
  void refuse(std::string_view key, std::string_view message);

  /// "section.key", for messages.
  std::string name(std::string_view key) const;

 private:
  void read_numbers(std::string_view key, const toml::node& node, std::vector<double>& target);
  bool read_integer(std::string_view key, std::int64_t& value, std::int64_t least, std::int64_t most);

  const toml::table& table_;
  std::string section_;
  const std::string& file_;
  std::optional<Error>& error_;
  std::vector<std::string> known_;
};

/// True for YYYY-MM-DD with a month and a day that exist.
bool is_date(std::string_view text);

}  // namespace clampd
