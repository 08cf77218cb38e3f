#include "clampd/record/utc.hpp"

#include <chrono>
#include <cstdio>
#include <ctime>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"
#include "clampd/base/entropy.hpp"

namespace clampd {
namespace {

/// Nanoseconds since 1970 reach into 2262.
constexpr int kFirstYear = 1970;
constexpr int kLastYear = 2261;

struct Moment {
  std::tm calendar{};
  int millisecond = 0;
};

Moment split(std::int64_t utc_ns) {
  Moment moment;
  const std::chrono::nanoseconds time(utc_ns);
  const auto second = std::chrono::floor<std::chrono::seconds>(time);  // also before 1970
  const std::time_t seconds = static_cast<std::time_t>(second.count());
  ::gmtime_r(&seconds, &moment.calendar);
  moment.millisecond = static_cast<int>((time - second).count() / kNanosecondsPerMillisecond);
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

std::optional<std::int64_t> parse_utc(const std::string& text) {
  int year = 0, used = 0;
  unsigned month = 0, day = 0, hour = 0, minute = 0, second = 0, millisecond = 0;
  if (std::sscanf(text.c_str(), "%4d-%2u-%2uT%2u:%2u:%2u.%3uZ%n", &year, &month, &day, &hour, &minute,
                  &second, &millisecond, &used) != 7 ||
      used != static_cast<int>(text.size()))
    return std::nullopt;
  using namespace std::chrono;
  const year_month_day date = std::chrono::year(year) / month / day;
  if (year < kFirstYear || year > kLastYear || !date.ok() || hour > 23 || minute > 59 || second > 60)
    return std::nullopt;
  const auto time =
      sys_days(date) + hours(hour) + minutes(minute) + seconds(second) + milliseconds(millisecond);
  return nanoseconds(time.time_since_epoch()).count();
}

std::string make_record_id(std::int64_t utc_ns) {
  const auto [t, millisecond] = split(utc_ns);
  std::random_device random = entropy();
  return fmt::format("{:04}{:02}{:02}T{:02}{:02}{:02}{:03}Z-{:08x}", t.tm_year + 1900, t.tm_mon + 1,
                     t.tm_mday, t.tm_hour, t.tm_min, t.tm_sec, millisecond, random());
}

}  // namespace clampd
