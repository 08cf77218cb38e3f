#include "drivers/can/dbc.hpp"

#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <limits>
#include <set>

#include "clampd/base/assert.hpp"
#include "clampd/record/file.hpp"
#include "drivers/can/frame.hpp"

namespace clampd::can {
namespace {

/// Vector's pseudo message that holds signals without a frame.
constexpr std::uint32_t kIndependentSignals = 0xC000'0000U;
constexpr std::size_t kMaxFrameBytes = 64;

struct Token {
  enum class Kind : std::uint8_t { Word, Number, Text, Mark, End };
  Kind kind = Kind::End;
  std::string_view text;  ///< without quotes
  int line = 1;
  int column = 1;

  bool is(char mark) const { return kind == Kind::Mark && text.front() == mark; }
  bool is(std::string_view word) const { return kind == Kind::Word && text == word; }
};

bool is_digit(char c) {
  return c >= '0' && c <= '9';
}
bool is_word_start(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
}
bool is_word(char c) {
  return is_word_start(c) || is_digit(c);
}

/// Thrown and caught inside of this file only: the grammar is recursive enough that threading a Result
/// through every token would hide it.
struct SyntaxError {
  std::string message;
};

class Lexer {
 public:
  Lexer(std::string_view text, const std::string& file) : text_{text}, file_{file} {}

  std::vector<Token> tokens() {
    std::vector<Token> all;
    do {
      all.push_back(next());
    } while (all.back().kind != Token::Kind::End);
    return all;
  }

 private:
  char peek(std::size_t ahead = 0) const {
    return position_ + ahead < text_.size() ? text_[position_ + ahead] : '\0';
  }

  void advance() {
    if (text_[position_++] == '\n') {
      ++line_;
      column_ = 1;
    } else {
      ++column_;
    }
  }

  bool starts_number() const {
    const char c = peek();
    if (is_digit(c)) return true;
    if (c == '.') return is_digit(peek(1));
    if (c != '+' && c != '-') return false;
    // "0-7" is a range and "@1-" a sign of their own; a sign belongs to a number only where a number may
    // start.
    const bool glued = position_ > 0 && is_word(text_[position_ - 1]);
    return !glued && (is_digit(peek(1)) || (peek(1) == '.' && is_digit(peek(2))));
  }

  Token next() {
    while (position_ < text_.size() &&
           (peek() == ' ' || peek() == '\t' || peek() == '\n' || peek() == '\r')) {
      advance();
    }
    Token token{Token::Kind::End, {}, line_, column_};
    if (position_ >= text_.size()) return token;
    const std::size_t begin = position_;
    if (peek() == '"') {
      advance();
      while (position_ < text_.size() && peek() != '"') {
        if (peek() == '\\' && position_ + 1 < text_.size()) advance();
        advance();
      }
      if (position_ >= text_.size()) {
        throw SyntaxError{fmt::format("{}:{}:{}: this text never ends: a closing '\"' is missing", file_,
                                      token.line, token.column)};
      }
      advance();
      token.kind = Token::Kind::Text;
      token.text = text_.substr(begin + 1, position_ - begin - 2);
      return token;
    }
    if (is_word_start(peek())) {
      while (is_word(peek())) advance();
      token.kind = Token::Kind::Word;
    } else if (starts_number()) {
      advance();
      while (is_digit(peek()) || peek() == '.' ||
             ((peek() == 'e' || peek() == 'E') &&
              (is_digit(peek(1)) || ((peek(1) == '-' || peek(1) == '+') && is_digit(peek(2))))) ||
             ((peek() == '-' || peek() == '+') &&
              (text_[position_ - 1] == 'e' || text_[position_ - 1] == 'E'))) {
        advance();
      }
      token.kind = Token::Kind::Number;
    } else if (std::string_view{":;|@+-(),[]"}.find(peek()) != std::string_view::npos) {
      advance();
      token.kind = Token::Kind::Mark;
    } else {
      const auto byte = static_cast<unsigned char>(peek());
      throw SyntaxError{fmt::format("{}:{}:{}: byte 0x{:02x} has no place in a DBC file here", file_, line_,
                                    column_, static_cast<unsigned>(byte))};
    }
    token.text = text_.substr(begin, position_ - begin);
    return token;
  }

  std::string_view text_;
  const std::string& file_;
  std::size_t position_ = 0;
  int line_ = 1;
  int column_ = 1;
};

/// Bit positions in transmission order of a byte array: byte * 8 + bit, bit 0 being the lowest. From the
/// signal's lowest bit up. Nothing if one lies outside of `size_bytes`.
std::optional<std::vector<std::size_t>> bit_positions(const Signal& signal, std::size_t size_bytes) {
  std::vector<std::size_t> positions(signal.bits);
  std::size_t position = signal.start_bit;
  for (std::size_t i = 0; i < signal.bits; ++i) {
    if (position >= 8 * size_bytes) return std::nullopt;
    if (signal.order == ByteOrder::Intel) {
      positions[i] = position++;
    } else {
      positions[signal.bits - 1 - i] = position;
      position = position % 8 == 0 ? position + 15 : position - 1;
    }
  }
  return positions;
}

using Ranges = std::vector<std::pair<std::uint64_t, std::uint64_t>>;

bool disjoint(const Ranges& a, const Ranges& b) {
  for (const auto& [a_from, a_to] : a) {
    for (const auto& [b_from, b_to] : b) {
      if (a_from <= b_to && b_from <= a_to) return false;
    }
  }
  return true;
}

/// Whether two signals can never be in the same frame: somewhere up their chains, one multiplexor selects one
/// or the other.
bool exclusive(const std::vector<Signal>& signals, std::size_t a, std::size_t b) {
  for (std::size_t x = a; signals[x].multiplexor; x = *signals[x].multiplexor) {
    for (std::size_t y = b; signals[y].multiplexor; y = *signals[y].multiplexor) {
      if (signals[x].multiplexor == signals[y].multiplexor &&
          disjoint(signals[x].selected_by, signals[y].selected_by)) {
        return true;
      }
    }
  }
  return false;
}

class Parser {
 public:
  Parser(std::string_view text, const std::string& file) : file_{file}, tokens_{Lexer{text, file}.tokens()} {
    database_.file = file;
  }

  Database parse() {
    while (peek().kind != Token::Kind::End) section();
    for (std::size_t i = 0; i < database_.messages.size(); ++i) finish(i);
    return std::move(database_);
  }

 private:
  struct SignalNote {
    Token token;                                  ///< the signal's name, for messages
    std::optional<std::uint64_t> multiplexed_by;  ///< "m3"
    bool extended = false;                        ///< SG_MUL_VAL_ named its multiplexor
  };

  const Token& peek(std::size_t ahead = 0) const {
    return tokens_[std::min(next_ + ahead, tokens_.size() - 1)];
  }
  const Token& take() {
    const Token& token = peek();
    if (next_ + 1 < tokens_.size()) ++next_;
    return token;
  }

  std::string at(const Token& token) const {
    return fmt::format("{}:{}:{}", file_, token.line, token.column);
  }

  [[noreturn]] void fail(const Token& token, const std::string& what) const {
    throw SyntaxError{fmt::format("{}: {}", at(token), what)};
  }

  [[noreturn]] void fail_expected(const Token& token, std::string_view expected) const {
    const std::string found = token.kind == Token::Kind::End
                                  ? "the file ends"
                                  : fmt::format("found '{}'", std::string{token.text.substr(0, 40)});
    fail(token, fmt::format("expected {}, {}", expected, found));
  }

  void expect(char mark) {
    if (!peek().is(mark)) fail_expected(peek(), fmt::format("'{}'", mark));
    take();
  }

  const Token& word(std::string_view what) {
    if (peek().kind != Token::Kind::Word) fail_expected(peek(), what);
    return take();
  }

  std::string text(std::string_view what) {
    if (peek().kind != Token::Kind::Text) fail_expected(peek(), fmt::format("{} in double quotes", what));
    const std::string_view raw = take().text;
    std::string plain;
    plain.reserve(raw.size());
    for (std::size_t i = 0; i < raw.size(); ++i) {
      if (raw[i] == '\\' && i + 1 < raw.size() && (raw[i + 1] == '"' || raw[i + 1] == '\\')) ++i;
      plain += raw[i];
    }
    return plain;
  }

  double number(std::string_view what) {
    const Token token = peek();
    if (token.kind != Token::Kind::Number) fail_expected(token, what);
    take();
    std::string_view digits = token.text;
    if (digits.front() == '+') digits.remove_prefix(1);
    double value = 0.0;
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (error != std::errc{} || end != digits.data() + digits.size() || !std::isfinite(value)) {
      fail_expected(token, what);
    }
    return value;
  }

  template <class Integer>
  Integer integer(std::string_view what, Integer smallest = std::numeric_limits<Integer>::min(),
                  Integer largest = std::numeric_limits<Integer>::max()) {
    const Token token = peek();
    if (token.kind != Token::Kind::Number) fail_expected(token, what);
    take();
    std::string_view digits = token.text;
    if (digits.front() == '+') digits.remove_prefix(1);
    Integer value{};
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (error != std::errc{} || end != digits.data() + digits.size() || value < smallest || value > largest) {
      fail_expected(token, fmt::format("{} between {} and {}", what, smallest, largest));
    }
    return value;
  }

  std::uint32_t message_id() { return integer<std::uint32_t>("a message id"); }

  static bool is_keyword(const Token& token) {
    static constexpr std::array kKeywords{std::string_view{"VERSION"},
                                          std::string_view{"NS_"},
                                          std::string_view{"BS_"},
                                          std::string_view{"BU_"},
                                          std::string_view{"VAL_TABLE_"},
                                          std::string_view{"BO_"},
                                          std::string_view{"SG_"},
                                          std::string_view{"BO_TX_BU_"},
                                          std::string_view{"EV_"},
                                          std::string_view{"CM_"},
                                          std::string_view{"ENVVAR_DATA_"},
                                          std::string_view{"BA_DEF_"},
                                          std::string_view{"BA_"},
                                          std::string_view{"BA_DEF_DEF_"},
                                          std::string_view{"VAL_"},
                                          std::string_view{"SIG_GROUP_"},
                                          std::string_view{"SIG_VALTYPE_"},
                                          std::string_view{"SG_MUL_VAL_"},
                                          std::string_view{"SGTYPE_"},
                                          std::string_view{"SIG_TYPE_REF_"},
                                          std::string_view{"BA_DEF_REL_"},
                                          std::string_view{"BA_REL_"},
                                          std::string_view{"BA_DEF_DEF_REL_"},
                                          std::string_view{"BA_DEF_SGTYPE_"},
                                          std::string_view{"BA_SGTYPE_"},
                                          std::string_view{"SIGTYPE_VALTYPE_"},
                                          std::string_view{"SGTYPE_VAL_"},
                                          std::string_view{"CAT_DEF_"},
                                          std::string_view{"CAT_"},
                                          std::string_view{"FILTER"},
                                          std::string_view{"EV_DATA_"},
                                          std::string_view{"BU_SG_REL_"},
                                          std::string_view{"BU_EV_REL_"},
                                          std::string_view{"BU_BO_REL_"},
                                          std::string_view{"NS_DESC_"}};
    return token.kind == Token::Kind::Word &&
           std::find(kKeywords.begin(), kKeywords.end(), token.text) != kKeywords.end();
  }

  void section() {
    const Token token = peek();
    if (!is_keyword(token) || token.is("SG_")) {
      fail_expected(token, "a section such as BO_, CM_ or VAL_ (SG_ only right after its BO_)");
    }
    take();
    if (token.is("VERSION")) {
      database_.version = text("the version");
    } else if (token.is("NS_")) {
      new_symbols();
    } else if (token.is("BS_")) {
      bit_timing();
    } else if (token.is("BU_")) {
      expect(':');
      while (peek().kind == Token::Kind::Word && !is_keyword(peek()))
        database_.nodes.emplace_back(take().text);
    } else if (token.is("VAL_TABLE_")) {
      const std::string name{word("a value table's name").text};
      database_.value_tables[name] = value_descriptions();
    } else if (token.is("BO_")) {
      message();
    } else if (token.is("CM_")) {
      comment();
    } else if (token.is("BA_DEF_DEF_")) {
      const std::string name = text("an attribute's name");
      database_.attribute_defaults[name] = attribute_value();
      expect(';');
    } else if (token.is("BA_")) {
      attribute();
    } else if (token.is("VAL_")) {
      signal_values();
    } else if (token.is("SIG_VALTYPE_")) {
      value_type();
    } else if (token.is("SG_MUL_VAL_")) {
      extended_multiplexing();
    } else {
      skip_statement(token);
    }
  }

  /// Statements that say nothing about a frame's layout: skipped up to their ';'.
  void skip_statement(const Token& keyword) {
    while (!peek().is(';')) {
      if (peek().kind == Token::Kind::End) fail_expected(peek(), fmt::format("';' to end {}", keyword.text));
      take();
    }
    take();
  }

  void new_symbols() {
    expect(':');
    // The list repeats keywords; a keyword with ':' behind it (BS_: or BU_:) is the next section.
    while (peek().kind == Token::Kind::Word && !peek(1).is(':')) take();
  }

  void bit_timing() {
    expect(':');
    if (peek().kind != Token::Kind::Number) return;
    number("a bit rate");
    expect(':');
    number("BTR1");
    expect(',');
    number("BTR2");
  }

  std::map<std::int64_t, std::string> value_descriptions() {
    std::map<std::int64_t, std::string> values;
    while (!peek().is(';')) {
      const auto raw = integer<std::int64_t>("a value or ';'");
      values[raw] = text("the value's description");
    }
    take();
    return values;
  }

  void message() {
    const Token id_token = peek();
    Message message;
    message.id = message_id();
    const bool independent = message.id == kIndependentSignals;
    if (!independent && database_.find_message(message.id) != nullptr) {
      fail(id_token, fmt::format("message id {} is used twice, first by {}", message.id,
                                 database_.find_message(message.id)->name));
    }
    const bool extended = (message.id & kExtendedId) != 0;
    if ((message.id & ~kExtendedId) > (extended ? 0x1FFF'FFFFU : 0x7FFU)) {
      message.defects.push_back(
          fmt::format("{}: message id {} is neither an 11-bit identifier nor a 29-bit one with bit 31 set",
                      at(id_token), message.id));
    }
    message.name = word("a message name").text;
    expect(':');
    message.size_bytes = integer<std::size_t>("the frame's size in bytes", 0, kMaxFrameBytes);
    message.sender = word("the sending node").text;
    if (database_.find_message(std::string_view{message.name}) != nullptr) {
      message.defects.push_back(fmt::format("{}: there is another message {}", at(id_token), message.name));
    }
    std::vector<SignalNote> notes;
    while (peek().is("SG_")) {
      take();
      signal(message, notes, independent);
    }
    if (independent) return;
    database_.messages.push_back(std::move(message));
    notes_.push_back(std::move(notes));
  }

  void signal(Message& message, std::vector<SignalNote>& notes, bool independent) {
    Signal signal;
    SignalNote note;
    note.token = word("a signal name");
    signal.name = note.token.text;
    if (peek().kind == Token::Kind::Word) multiplex_mark(take(), signal, note);
    expect(':');
    signal.start_bit = integer<std::size_t>("the start bit", 0, 8 * kMaxFrameBytes - 1);
    expect('|');
    signal.bits = integer<std::size_t>("the number of bits", 1, 64);
    expect('@');
    signal.order = integer<int>("the byte order", 0, 1) == 1 ? ByteOrder::Intel : ByteOrder::Motorola;
    if (peek().is('-')) {
      signal.type = ValueType::Signed;
    } else if (!peek().is('+')) {
      fail_expected(peek(), "'+' (unsigned) or '-' (signed)");
    }
    take();
    expect('(');
    const Token scale_token = peek();
    signal.scale = number("the scale");
    if (signal.scale == 0.0) fail(scale_token, fmt::format("signal {} has a scale of zero", signal.name));
    expect(',');
    signal.offset = number("the offset");
    expect(')');
    expect('[');
    signal.minimum = number("the smallest value");
    expect('|');
    signal.maximum = number("the largest value");
    expect(']');
    signal.unit = text("the unit");
    signal.receivers.emplace_back(word("a receiving node").text);
    while (peek().is(',') || (peek().kind == Token::Kind::Word && !is_keyword(peek()))) {
      if (peek().is(',')) take();
      signal.receivers.emplace_back(word("a receiving node").text);
    }
    if (signal.minimum > signal.maximum) {
      message.defects.push_back(
          fmt::format("{}: the range of {} is upside down", at(note.token), signal.name));
    }
    if (message.find_signal(signal.name) != nullptr) {
      message.defects.push_back(
          fmt::format("{}: message {} has two signals {}", at(note.token), message.name, signal.name));
    }
    if (!independent && !bit_positions(signal, message.size_bytes)) {
      fail(note.token,
           fmt::format("signal {} ({} bits from bit {}) does not lie inside of the {} bytes of {}",
                       signal.name, signal.bits, signal.start_bit, message.size_bytes, message.name));
    }
    message.signals.push_back(std::move(signal));
    notes.push_back(note);
  }

  void multiplex_mark(const Token& mark, Signal& signal, SignalNote& note) {
    std::string_view digits = mark.text;
    if (digits == "M") {
      signal.is_multiplexor = true;
      return;
    }
    if (digits.size() > 2 && digits.back() == 'M') {
      signal.is_multiplexor = true;
      digits.remove_suffix(1);
    }
    std::uint64_t value = 0;
    const bool starts = digits.size() > 1 && digits.front() == 'm';
    if (starts) digits.remove_prefix(1);
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (!starts || error != std::errc{} || end != digits.data() + digits.size()) {
      fail_expected(mark, "':' or a multiplexing mark (M, m3, m3M)");
    }
    note.multiplexed_by = value;
    signal.selected_by = {{value, value}};
  }

  /// Index of a message, or nothing (noted as a defect) if the file refers to one that it does not have.
  std::optional<std::size_t> resolve_message() {
    const Token token = peek();
    const std::uint32_t id = message_id();
    for (std::size_t i = 0; i < database_.messages.size(); ++i) {
      if (database_.messages[i].id == id) return i;
    }
    if (id != kIndependentSignals) {
      database_.defects.push_back(fmt::format("{}: there is no message {}", at(token), id));
    }
    return std::nullopt;
  }

  /// Reads "id name" and gives message and signal index, or nothing as above.
  std::optional<std::pair<std::size_t, std::size_t>> resolve_signal() {
    const auto message_index = resolve_message();
    const Token token = word("a signal name");
    if (!message_index) return std::nullopt;
    const Message& message = database_.messages[*message_index];
    for (std::size_t i = 0; i < message.signals.size(); ++i) {
      if (message.signals[i].name == token.text) return std::pair{*message_index, i};
    }
    database_.defects.push_back(
        fmt::format("{}: message {} has no signal {}", at(token), message.name, token.text));
    return std::nullopt;
  }

  Signal& signal_at(std::pair<std::size_t, std::size_t> place) {
    return database_.messages[place.first].signals[place.second];
  }

  void comment() {
    if (peek().is("BO_")) {
      take();
      const auto index = resolve_message();
      std::string comment = text("a comment");
      if (index) database_.messages[*index].comment = std::move(comment);
    } else if (peek().is("SG_")) {
      take();
      const auto place = resolve_signal();
      std::string comment = text("a comment");
      if (place) signal_at(*place).comment = std::move(comment);
    } else if (peek().is("BU_") || peek().is("EV_")) {
      take();
      word("a name");
      text("a comment");
    } else {
      text("a comment");
    }
    expect(';');
  }

  std::string attribute_value() {
    if (peek().kind == Token::Kind::Text) return text("a value");
    if (peek().kind != Token::Kind::Number) fail_expected(peek(), "a number or a text in double quotes");
    return std::string{take().text};
  }

  void attribute() {
    const std::string name = text("an attribute's name");
    if (peek().is("BO_")) {
      take();
      const auto index = resolve_message();
      std::string value = attribute_value();
      if (index) database_.messages[*index].attributes[name] = std::move(value);
    } else if (peek().is("SG_")) {
      take();
      resolve_signal();
      attribute_value();
    } else {
      if (peek().is("BU_") || peek().is("EV_")) {
        take();
        word("a name");
      }
      attribute_value();
    }
    expect(';');
  }

  void signal_values() {
    if (peek().kind == Token::Kind::Word) {  // of an environment variable
      take();
      value_descriptions();
      return;
    }
    const auto place = resolve_signal();
    auto values = value_descriptions();
    if (place) signal_at(*place).values = std::move(values);
  }

  void value_type() {
    const auto place = resolve_signal();
    if (peek().is(':')) take();
    const Token token = peek();
    const int type = integer<int>("0 (integer), 1 (float) or 2 (double)", 0, 2);
    expect(';');
    if (!place || type == 0) return;
    Signal& signal = signal_at(*place);
    const std::size_t bits = type == 1 ? 32 : 64;
    if (signal.bits != bits) {
      fail(token, fmt::format("signal {} cannot be a floating point number of {} bits: it has {}",
                              signal.name, bits, signal.bits));
    }
    signal.type = type == 1 ? ValueType::Float32 : ValueType::Float64;
  }

  void extended_multiplexing() {
    const auto place = resolve_signal();
    const Token multiplexor_token = word("the multiplexor's name");
    Ranges ranges;
    do {
      if (!ranges.empty()) take();
      const Token token = peek();
      const auto from = integer<std::uint64_t>("the first value of a range");
      expect('-');
      const auto to = integer<std::uint64_t>("the last value of a range");
      if (from > to) fail(token, fmt::format("the range {}-{} is upside down", from, to));
      ranges.emplace_back(from, to);
    } while (peek().is(','));
    expect(';');
    if (!place) return;
    Message& message = database_.messages[place->first];
    for (std::size_t i = 0; i < message.signals.size(); ++i) {
      if (message.signals[i].name != multiplexor_token.text) continue;
      if (!message.signals[i].is_multiplexor || i == place->second) break;
      message.signals[place->second].multiplexor = i;
      message.signals[place->second].selected_by = std::move(ranges);
      notes_[place->first][place->second].extended = true;
      return;
    }
    fail_expected(multiplexor_token, fmt::format("a multiplexor (marked M) of message {}", message.name));
  }

  /// Resolves simple multiplexing, then looks for signals that share bits.
  void finish(std::size_t index) {
    Message& message = database_.messages[index];
    const std::vector<SignalNote>& notes = notes_[index];
    std::vector<Signal>& signals = message.signals;
    std::optional<std::size_t> root;
    std::size_t roots = 0;
    for (std::size_t i = 0; i < signals.size(); ++i) {
      if (signals[i].is_multiplexor && !notes[i].multiplexed_by) {
        root = i;
        ++roots;
      }
    }
    for (std::size_t i = 0; i < signals.size(); ++i) {
      if (!notes[i].multiplexed_by || notes[i].extended) continue;
      if (roots != 1) {
        fail(notes[i].token,
             fmt::format("signal {} is multiplexed, but message {} has {} multiplexors (M): expected "
                         "one, or an SG_MUL_VAL_ that names it",
                         signals[i].name, message.name, roots));
      }
      signals[i].multiplexor = root;
    }
    for (std::size_t i = 0; i < signals.size(); ++i) {
      std::size_t steps = 0;
      for (std::size_t x = i; signals[x].multiplexor; x = *signals[x].multiplexor) {
        if (++steps > signals.size()) {
          fail(notes[i].token,
               fmt::format("the multiplexors of signal {} go round in a circle", signals[i].name));
        }
      }
    }
    find_overlaps(message, notes);
  }

  void find_overlaps(Message& message, const std::vector<SignalNote>& notes) const {
    std::vector<std::vector<std::size_t>> users(8 * message.size_bytes);
    std::set<std::pair<std::size_t, std::size_t>> reported;
    for (std::size_t i = 0; i < message.signals.size(); ++i) {
      const auto positions = bit_positions(message.signals[i], message.size_bytes);
      for (const std::size_t position : *positions) {
        for (const std::size_t other : users[position]) {
          if (exclusive(message.signals, i, other) || !reported.emplace(other, i).second) continue;
          message.defects.push_back(fmt::format("{}: signal {} overlaps signal {} of message {}",
                                                at(notes[i].token), message.signals[i].name,
                                                message.signals[other].name, message.name));
        }
        users[position].push_back(i);
      }
    }
  }

  const std::string& file_;
  std::vector<Token> tokens_;
  std::size_t next_ = 0;
  Database database_;
  std::vector<std::vector<SignalNote>> notes_;  ///< beside database_.messages
};

std::uint64_t field_mask(std::size_t bits) {
  return bits == 64 ? ~0ULL : (1ULL << bits) - 1;
}

}  // namespace

const Signal* Message::find_signal(std::string_view signal_name) const {
  const auto found = std::find_if(signals.begin(), signals.end(),
                                  [&](const Signal& signal) { return signal.name == signal_name; });
  return found == signals.end() ? nullptr : &*found;
}

const Message* Database::find_message(std::string_view message_name) const {
  const auto found = std::find_if(messages.begin(), messages.end(),
                                  [&](const Message& message) { return message.name == message_name; });
  return found == messages.end() ? nullptr : &*found;
}

const Message* Database::find_message(std::uint32_t id) const {
  const auto found = std::find_if(messages.begin(), messages.end(),
                                  [&](const Message& message) { return message.id == id; });
  return found == messages.end() ? nullptr : &*found;
}

Result<Database> parse_dbc(std::string_view text, const std::string& name) {
  try {
    Database database = Parser{text, name}.parse();
    if (database.messages.empty()) {
      return failure(fmt::format("{}:1:1: expected at least one message (BO_): is this a DBC file?", name));
    }
    return database;
  } catch (const SyntaxError& error) {
    return failure(error.message);
  }
}

Result<Database> read_dbc(const std::string& path) {
  return read_file(path).and_then([&](const std::string& text) { return parse_dbc(text, path); });
}

std::uint64_t extract_raw(const Signal& signal, std::span<const std::uint8_t> data) {
  const auto positions = bit_positions(signal, data.size());
  CLAMPD_ASSERT(positions.has_value());
  std::uint64_t raw = 0;
  for (std::size_t i = 0; i < signal.bits; ++i) {
    const std::size_t position = (*positions)[i];
    raw |= static_cast<std::uint64_t>((data[position / 8] >> (position % 8)) & 1U) << i;
  }
  if (signal.type == ValueType::Signed && ((raw >> (signal.bits - 1)) & 1U) != 0)
    raw |= ~field_mask(signal.bits);
  return raw;
}

void insert_raw(const Signal& signal, std::uint64_t raw, std::span<std::uint8_t> data) {
  const auto positions = bit_positions(signal, data.size());
  CLAMPD_ASSERT(positions.has_value());
  for (std::size_t i = 0; i < signal.bits; ++i) {
    std::uint8_t& byte = data[(*positions)[i] / 8];
    const auto bit = static_cast<std::uint8_t>(1U << ((*positions)[i] % 8));
    byte = static_cast<std::uint8_t>(((raw >> i) & 1U) != 0 ? byte | bit : byte & ~bit);
  }
}

double decode(const Signal& signal, std::span<const std::uint8_t> data) {
  const std::uint64_t raw = extract_raw(signal, data);
  double value = 0.0;
  switch (signal.type) {
    case ValueType::Unsigned:
      value = static_cast<double>(raw);
      break;
    case ValueType::Signed:
      value = static_cast<double>(static_cast<std::int64_t>(raw));
      break;
    case ValueType::Float32:
      value = std::bit_cast<float>(static_cast<std::uint32_t>(raw));
      break;
    case ValueType::Float64:
      value = std::bit_cast<double>(raw);
      break;
  }
  return value * signal.scale + signal.offset;
}

void encode(const Signal& signal, double physical, std::span<std::uint8_t> data) {
  const double value = (physical - signal.offset) / signal.scale;
  std::uint64_t raw = 0;
  switch (signal.type) {
    case ValueType::Unsigned: {
      const double largest = std::ldexp(1.0, static_cast<int>(signal.bits));
      raw = !(value > 0.0)                 ? 0
            : std::round(value) >= largest ? field_mask(signal.bits)
                                           : static_cast<std::uint64_t>(std::round(value));
      break;
    }
    case ValueType::Signed: {
      const double largest = std::ldexp(1.0, static_cast<int>(signal.bits) - 1);
      const std::uint64_t top = field_mask(signal.bits) >> 1U;
      if (std::isnan(value)) {
        raw = 0;
      } else if (std::round(value) >= largest) {
        raw = top;
      } else if (std::round(value) <= -largest) {
        raw = ~top;
      } else {
        raw = static_cast<std::uint64_t>(static_cast<std::int64_t>(std::round(value)));
      }
      break;
    }
    case ValueType::Float32:
      raw = std::bit_cast<std::uint32_t>(static_cast<float>(value));
      break;
    case ValueType::Float64:
      raw = std::bit_cast<std::uint64_t>(value);
      break;
  }
  insert_raw(signal, raw, data);
}

}  // namespace clampd::can
