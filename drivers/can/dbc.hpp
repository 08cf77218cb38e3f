#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "clampd/base/result.hpp"

namespace clampd::can {

enum class ByteOrder : std::uint8_t { Motorola, Intel };
enum class ValueType : std::uint8_t { Unsigned, Signed, Float32, Float64 };

/// One signal of a message. physical = raw * scale + offset, in `unit`.
struct Signal {
  std::string name;
  std::size_t start_bit = 0;  ///< DBC numbering: lowest bit (Intel) or highest bit (Motorola)
  std::size_t bits = 0;
  ByteOrder order = ByteOrder::Intel;
  ValueType type = ValueType::Unsigned;
  double scale = 1.0;
  double offset = 0.0;
  double minimum = 0.0;  ///< physical; minimum == maximum == 0 means that the file states no range
  double maximum = 0.0;
  std::string unit;
  std::vector<std::string> receivers;
  bool is_multiplexor = false;
  std::optional<std::size_t> multiplexor;  ///< index of the signal that selects this one
  std::vector<std::pair<std::uint64_t, std::uint64_t>> selected_by;  ///< inclusive ranges of its raw value
  std::map<std::int64_t, std::string> values;                        ///< VAL_: raw value to text
  std::string comment;

  bool has_range() const { return minimum != 0.0 || maximum != 0.0; }
};

struct Message {
  std::uint32_t id = 0;  ///< bit 31 set: 29-bit identifier
  std::string name;
  std::size_t size_bytes = 0;  ///< up to 64 (CAN FD)
  std::string sender;
  std::vector<Signal> signals;
  std::string comment;
  std::map<std::string, std::string> attributes;  ///< BA_ of this message, as written
  /// What a real file gets away with but nobody should build on: overlapping signals, two of one name, a
  /// range upside down. Each starts with file:line:column.
  std::vector<std::string> defects;

  const Signal* find_signal(std::string_view signal_name) const;
};

/// The content of one DBC file; immutable after reading.
struct Database {
  std::string file;
  std::string version;
  std::vector<std::string> nodes;
  std::vector<Message> messages;
  std::map<std::string, std::map<std::int64_t, std::string>> value_tables;
  std::map<std::string, std::string> attribute_defaults;  ///< BA_DEF_DEF_, as written
  std::vector<std::string> defects;  ///< references to messages or signals that the file does not have

  const Message* find_message(std::string_view message_name) const;
  const Message* find_message(std::uint32_t id) const;
};

/// Reads DBC text; `name` stands for the file in messages. Errors are "file:line:column: what, and what was
/// expected": anything that does not parse, an id given twice, a signal outside of its frame, a signal of no
/// or over 64 bits, a scale of zero, an unresolvable multiplexor.
Result<Database> parse_dbc(std::string_view text, const std::string& name);

/// The same from a file.
Result<Database> read_dbc(const std::string& path);

/// Raw bits of a signal, sign-extended if it is signed (then to be read as int64). For any frame size, bit by
/// bit: the real-time path uses codec.hpp. `data` must hold the whole signal.
std::uint64_t extract_raw(const Signal& signal, std::span<const std::uint8_t> data);
void insert_raw(const Signal& signal, std::uint64_t raw, std::span<std::uint8_t> data);

/// Physical value, in the signal's unit.
double decode(const Signal& signal, std::span<const std::uint8_t> data);
/// Rounds to the nearest raw value and saturates at the field's limits.
void encode(const Signal& signal, double physical, std::span<std::uint8_t> data);

}  // namespace clampd::can
