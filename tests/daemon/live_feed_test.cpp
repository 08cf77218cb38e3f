#include "clampd/daemon/live_feed.hpp"

#include <gtest/gtest.h>

namespace clampd::daemon {
namespace {

Sample row(std::int32_t index, std::uint16_t repeat, std::uint8_t trajectory) {
  Sample sample;
  sample.trajectory_index = index;
  sample.repeat = repeat;
  sample.trajectory = trajectory;
  sample.force_N = 100.0 * repeat + index;
  return sample;
}

TEST(LiveFeed, GivesTheRunUnderWayWithTheTrajectoryThatItFollows) {
  LiveFeed feed;
  EXPECT_EQ(feed.since(0, 0)["run"], 0);
  for (const std::int32_t index : {0, 1, 2}) feed.take(row(index, 4, 0));
  const nlohmann::ordered_json own = feed.since(1, 1);
  EXPECT_EQ(own["trajectory"], 0);
  EXPECT_EQ(own["force_N"], (std::vector{401.0, 402.0})) << "from the row that was asked for";
  feed.take(row(-1, 4, 0));
  for (const std::int32_t index : {0, 1}) feed.take(row(index, 5, 2));
  const nlohmann::ordered_json chosen = feed.since(1, 3);
  EXPECT_EQ(chosen["run"], 2);
  EXPECT_EQ(chosen["repeat"], 5);
  EXPECT_EQ(chosen["trajectory"], 2);
  EXPECT_EQ(chosen["from"], 0) << "another run by now: all of it";
  EXPECT_EQ(chosen["force_N"], (std::vector{500.0, 501.0}));
}

}  // namespace
}  // namespace clampd::daemon
