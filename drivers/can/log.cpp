#include "drivers/can/log.hpp"

#include <charconv>
#include <cmath>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"

namespace clampd::can {
namespace {

constexpr std::uint32_t kErrorFlag = 0x2000'0000U;  // of SocketCAN, in the identifier

/// Words of a line, one after the other.
class Words {
 public:
  explicit Words(std::string_view line) : rest_(line) {}

  std::string_view next() {
    const std::size_t begin = rest_.find_first_not_of(" \t\r");
    if (begin == std::string_view::npos) return rest_ = {};
    const std::size_t end = std::min(rest_.find_first_of(" \t\r", begin), rest_.size());
    const std::string_view word = rest_.substr(begin, end - begin);
    rest_.remove_prefix(end);
    return word;
  }

 private:
  std::string_view rest_;
};

template <class Number>
bool read_number(std::string_view text, Number& value, int base) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value, base);
  return !text.empty() && error == std::errc{} && end == text.data() + text.size();
}

/// "(seconds.fraction)"
std::optional<std::int64_t> time_of(std::string_view word) {
  double seconds = 0.0;
  const std::string_view inside = word.substr(1, word.size() - 2);
  const auto [end, error] = std::from_chars(inside.data(), inside.data() + inside.size(), seconds);
  constexpr double kMost_s = 9e9;  // in nanoseconds it still fits
  if (error != std::errc{} || end != inside.data() + inside.size() || !(std::abs(seconds) < kMost_s))
    return std::nullopt;
  return std::llround(seconds * 1e9);
}

/// Three digits are an 11-bit identifier, eight a 29-bit one, as can-utils write them.
bool read_id(std::string_view text, std::uint32_t& id) {
  if ((text.size() != 3 && text.size() != 8) || !read_number(text, id, 16)) return false;
  if (text.size() == 8) id |= kExtendedId;
  return true;
}

enum class Line : std::uint8_t { Data, Skipped, Unreadable };

bool read_bytes(std::string_view digits, Frame& frame) {
  if (digits.size() % 2 != 0 || digits.size() > 2 * kMaxFrameBytes) return false;
  frame.size = static_cast<std::uint8_t>(digits.size() / 2);
  for (std::size_t i = 0; i < frame.size; ++i)
    if (!read_number(digits.substr(2 * i, 2), frame.data[i], 16)) return false;
  return true;
}

bool has_right_size(const Frame& frame) {
  return frame.format == FrameFormat::Classic ? frame.size <= kClassicBytes : is_fd_size(frame.size);
}

/// "180#001122", "180#R", "18FF0001##1001122"
Line read_compact(std::string_view word, Frame& frame) {
  const std::size_t hash = word.find('#');
  if (!read_id(word.substr(0, hash), frame.id)) return Line::Unreadable;
  if ((frame.id & kErrorFlag) != 0 && (frame.id & kExtendedId) != 0) return Line::Skipped;
  std::string_view data = word.substr(hash + 1);
  if (data.starts_with('R')) return Line::Skipped;
  if (data.starts_with('#')) {
    unsigned flags = 0;
    if (data.size() < 2 || !read_number(data.substr(1, 1), flags, 16)) return Line::Unreadable;
    frame.format = (flags & 1U) != 0 ? FrameFormat::FdFastData : FrameFormat::Fd;
    data.remove_prefix(2);
  }
  // A classic frame may end in "_9" and the like, a data length code above 8.
  data = data.substr(0, data.find('_'));
  return read_bytes(data, frame) && has_right_size(frame) ? Line::Data : Line::Unreadable;
}

/// "180   [8]  00 11 ...", CAN FD as "[08]" with two digits.
Line read_shown(std::string_view id, Words& words, Frame& frame) {
  if (!read_id(id, frame.id)) return Line::Unreadable;
  const std::string_view length = words.next();
  std::size_t size = 0;
  if (length.size() < 3 || length.front() != '[' || length.back() != ']' ||
      !read_number(length.substr(1, length.size() - 2), size, 10))
    return Line::Unreadable;
  frame.format = length.size() == 4 ? FrameFormat::Fd : FrameFormat::Classic;
  std::string digits;
  for (std::size_t i = 0; i < size && digits.size() <= 2 * kMaxFrameBytes; ++i) {
    const std::string_view byte = words.next();
    if (byte == "remote") return Line::Skipped;
    if (byte.size() != 2) return Line::Unreadable;
    digits += byte;
  }
  if ((frame.id & kErrorFlag) != 0 && (frame.id & kExtendedId) != 0) return Line::Skipped;
  return read_bytes(digits, frame) && frame.size == size && has_right_size(frame) ? Line::Data
                                                                                  : Line::Unreadable;
}

Line read_line(std::string_view line, LoggedFrame& logged) {
  Words words(line);
  std::string_view word = words.next();
  if (word.empty() || word.front() == '#' || word.front() == ';') return Line::Skipped;
  if (word.front() == '(') {
    if (word.size() < 3 || word.back() != ')') return Line::Unreadable;
    logged.time_ns = time_of(word);
    if (!logged.time_ns) return Line::Unreadable;
    word = words.next();
  }
  const std::string_view interface = word;
  const std::string_view content = words.next();
  if (interface.empty() || content.empty()) return Line::Unreadable;
  if (content.find('#') != std::string_view::npos) return read_compact(content, logged.frame);
  // Between interface and identifier candump -x shows the direction.
  if (content == "RX" || content == "TX") {
    std::string_view id = words.next();
    while (id == "-" || id == "--" || id == "B" || id == "E") id = words.next();
    return read_shown(id, words, logged.frame);
  }
  return read_shown(content, words, logged.frame);
}

}  // namespace

std::string id_text(std::uint32_t id) {
  return (id & kExtendedId) != 0 ? fmt::format("{:08X}", id & ~kExtendedId) : fmt::format("{:03X}", id);
}

Result<FrameLog> parse_log(std::string_view text, const std::string& name) {
  FrameLog log;
  const std::string first(text.substr(0, std::min<std::size_t>(text.find_first_of("\r\n"), 60)));
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    LoggedFrame logged;
    ++log.lines;
    switch (read_line(text.substr(0, end), logged)) {
      case Line::Data:
        log.frames.push_back(logged);
        break;
      case Line::Skipped:
        ++log.skipped;
        break;
      case Line::Unreadable:
        ++log.unreadable;
        if (log.first_unreadable == 0) log.first_unreadable = log.lines;
        break;
    }
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  if (log.lines == 0)
    return failure(fmt::format("{} is empty; record with 'candump -l can0' while the brake sends", name));
  if (log.frames.empty())
    return failure(fmt::format(
        "{}: no CAN frame in its {} lines, the first of which is \"{}\"; record with 'candump -l can0'", name,
        log.lines, first));
  return log;
}

}  // namespace clampd::can
