#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace clampd {

/// CLOCK_REALTIME now, nanoseconds since 1970. For records and file names only, never for control.
std::int64_t utc_now_ns();

/// RFC 3339 in UTC with milliseconds: 2026-11-20T23:41:07.123Z
std::string format_utc(std::int64_t utc_ns);

/// The same back, nanoseconds since 1970; nothing if it is not of this form, before 1970 or after
/// 2261.
std::optional<std::int64_t> parse_utc(const std::string& text);

/// A record's id: unique, and sorted by name it is sorted by time: 20261120T234107123Z-9f3a61c2
std::string make_record_id(std::int64_t utc_ns);

}  // namespace clampd
