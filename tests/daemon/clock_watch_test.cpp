#include "clampd/daemon/clock_watch.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"

namespace clampd::daemon {
namespace {

using ::testing::IsEmpty;
using ::testing::StartsWith;

constexpr std::int64_t kUtc_s = 1'800'000'000;

bench::Instant at(double steady_s, double ahead_s) {
  return {static_cast<std::int64_t>(steady_s * 1e9),
          kUtc_s * kNanosecondsPerSecond + static_cast<std::int64_t>((steady_s + ahead_s) * 1e9)};
}

TEST(ClockWatch, SaysOnceThatTheClockWasSet) {
  ClockWatch watch;
  EXPECT_THAT(watch.look(at(10.0, 0.0)), IsEmpty()) << "whatever it was set to before";
  EXPECT_THAT(watch.look(at(10.005, 0.0)), IsEmpty());
  EXPECT_THAT(watch.look(at(10.010, -3600.0)), StartsWith("the clock was set back by 60 min: "));
  EXPECT_THAT(watch.look(at(10.015, -3600.0)), IsEmpty());
  EXPECT_THAT(watch.look(at(10.020, 3600.0)), StartsWith("the clock was set forward by 2.0 h: "));
}

TEST(ClockWatch, KeepsQuietAboutLongPausesAndCorrections) {
  ClockWatch watch;
  EXPECT_THAT(watch.look(at(10.0, 0.0)), IsEmpty());
  EXPECT_THAT(watch.look(at(500.0, 0.0)), IsEmpty()) << "not asked for minutes";
  for (double second = 501.0; second < 600.0; second += 1.0)
    EXPECT_THAT(watch.look(at(second, (second - 500.0) * 0.5)), IsEmpty()) << "slewed, however fast";
}

}  // namespace
}  // namespace clampd::daemon
