#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/base/result.hpp"
#include "drivers/can/frame.hpp"

namespace clampd::can {

/// An identifier as can-utils write it: three digits for 11 bits, eight for 29.
std::string id_text(std::uint32_t id);

/// One data frame of a log.
struct LoggedFrame {
  std::optional<std::int64_t> time_ns;  ///< as the log has it; nothing where it has no time stamps
  Frame frame;
};

struct FrameLog {
  std::vector<LoggedFrame> frames;
  std::size_t lines = 0;
  std::size_t skipped = 0;           ///< remote and error frames, comments, empty lines
  std::size_t unreadable = 0;        ///< lines
  std::size_t first_unreadable = 0;  ///< its number, from 1; 0 if none
};

/// Reads what can-utils write: `candump -l` ("(1700000000.000100) can0 180#0011", CAN FD after "##" and a
/// digit of flags) and the lines that candump shows, with or without time stamps
/// ("(000.000100)  can0  180   [8]  00 11 ..."). Lines of another kind are counted, not errors.
/// Errors: no data frame in the whole text; the message shows the first line.
Result<FrameLog> parse_log(std::string_view text, const std::string& name);

}  // namespace clampd::can
