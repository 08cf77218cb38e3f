#include "clampd/record/utc.hpp"

#include <chrono>
#include <ctime>
#include <random>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"

namespace clampd {
namespace {

struct Moment {
  std::tm calendar{};
  int millisecond = 0;
};

Moment split(std::int64_t utc_ns) {
  Moment moment;
  const std::time_t seconds = static_cast<std::time_t>(utc_ns / kNanosecondsPerSecond);
  ::gmtime_r(&seconds, &moment.calendar);
  moment.millisecond = static_cast<int>(utc_ns % kNanosecondsPerSecond / kNanosecondsPerMillisecond);
  return moment;
}

}  // namespace

std::int64_t utc_now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

std::string format_utc(std::int64_t utc_ns) {
  const auto [t, millisecond] = split(utc_ns);
  return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:03}Z", t.tm_year + 1900, t.tm_mon + 1, t.tm_mday,
                     t.tm_hour, t.tm_min, t.tm_sec, millisecond);
}

std::string make_record_id(std::int64_t utc_ns) {
  const auto [t, millisecond] = split(utc_ns);
  std::random_device random;
  return fmt::format("{:04}{:02}{:02}T{:02}{:02}{:02}{:03}Z-{:08x}", t.tm_year + 1900, t.tm_mon + 1,
                     t.tm_mday, t.tm_hour, t.tm_min, t.tm_sec, millisecond, random());
}

}  // namespace clampd
