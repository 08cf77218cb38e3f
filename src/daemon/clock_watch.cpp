#include "clampd/daemon/clock_watch.hpp"

#include <cstdlib>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"

namespace clampd::daemon {

namespace {

constexpr std::int64_t kNoticed_ns = 2 * kNanosecondsPerSecond;

std::string in_words(double seconds) {
  if (seconds < 120.0) return fmt::format("{:.0f} s", seconds);
  if (seconds < 7200.0) return fmt::format("{:.0f} min", seconds / 60.0);
  return fmt::format("{:.1f} h", seconds / 3600.0);
}

}  // namespace

std::string ClockWatch::look(bench::Instant now) {
  const std::int64_t offset_ns = now.utc_ns - now.steady_ns;
  const std::int64_t step_ns = offset_ns - std::exchange(offset_ns_, offset_ns).value_or(offset_ns);
  if (std::abs(step_ns) < kNoticed_ns) return {};
  return fmt::format(
      "the clock was set {} by {}: time stamps before and after do not compare; the history keeps the "
      "order in which brakes were checked",
      step_ns > 0 ? "forward" : "back",
      in_words(static_cast<double>(std::abs(step_ns)) / static_cast<double>(kNanosecondsPerSecond)));
}

}  // namespace clampd::daemon
