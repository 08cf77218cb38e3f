#include "drivers/can/embedded_bus.hpp"

#include <gtest/gtest.h>

#include <array>

namespace clampd::can {
namespace {

using End = EmbeddedBus::End;

Frame numbered(std::uint8_t number) {
  return Frame{0x123, 8, {number, 0, 0, 0, 0, 0, 0, 0}};
}

class Embedded : public ::testing::Test {
 protected:
  EmbeddedBus bus_{1e6};
  FrameBus& station_ = bus_.end(End::Station);
  FrameBus& brake_ = bus_.end(End::Brake);
  std::array<TimedFrame, 300> received_;
};

TEST_F(Embedded, AFrameTakesItsTimeOnTheWire) {
  ASSERT_TRUE(brake_.send(numbered(1), 1000));
  EXPECT_EQ(station_.receive(received_, 1000 + 134'999), 0U);
  ASSERT_EQ(station_.receive(received_, 1000 + 135'000), 1U);
  EXPECT_EQ(received_[0].frame, numbered(1));
  EXPECT_EQ(received_[0].arrival_ns, 136'000);
  EXPECT_EQ(brake_.receive(received_, 1'000'000), 0U) << "nobody hears himself";
}

TEST_F(Embedded, FramesOfBothEndsShareTheWireInOrder) {
  brake_.send(numbered(1), 0);
  brake_.send(numbered(2), 0);
  station_.send(numbered(3), 0);
  ASSERT_EQ(station_.receive(received_, 1'000'000), 2U);
  EXPECT_EQ(received_[0].arrival_ns, 135'000);
  EXPECT_EQ(received_[1].arrival_ns, 270'000);
  ASSERT_EQ(brake_.receive(received_, 1'000'000), 1U);
  EXPECT_EQ(received_[0].arrival_ns, 405'000);
  EXPECT_EQ(station_.health().bus_bits, 3U * 135U);
  EXPECT_EQ(brake_.health().bus_bits, 3U * 135U);
  EXPECT_EQ(brake_.health().frames_sent, 2U);
  EXPECT_EQ(station_.health().frames_received, 2U);
}

TEST_F(Embedded, WhatDoesNotFitWaits) {
  for (std::uint8_t i = 0; i < 3; ++i) brake_.send(numbered(i), 0);
  EXPECT_EQ(station_.receive(std::span{received_}.first(2), 1'000'000), 2U);
  ASSERT_EQ(station_.receive(received_, 1'000'000), 1U);
  EXPECT_EQ(received_[0].frame.data[0], 2);
}

TEST_F(Embedded, AFullQueueDropsCountsAndSaysSo) {
  for (int i = 0; i < 300; ++i) brake_.send(numbered(static_cast<std::uint8_t>(i)), 0);
  EXPECT_EQ(station_.receive(received_, 1'000'000'000), 256U);
  EXPECT_EQ(station_.health().receive_overflows, 44U);
}

TEST_F(Embedded, DropsAndCorruptsOnDemand) {
  bus_.drop_next(End::Brake, 1);
  brake_.send(numbered(1), 0);
  bus_.corrupt_next(End::Brake, 1);
  brake_.send(numbered(2), 0);
  brake_.send(numbered(4), 0);
  ASSERT_EQ(station_.receive(received_, 1'000'000), 2U);
  EXPECT_NE(received_[0].frame, numbered(2));
  EXPECT_EQ(received_[1].frame, numbered(4));
}

TEST_F(Embedded, ADeadLinkSendsNothing) {
  for (const LinkState link : {LinkState::Down, LinkState::Gone, LinkState::BusOff}) {
    brake_.send(numbered(1), 0);
    bus_.set_link(link);
    EXPECT_FALSE(station_.send(numbered(1), 0));
    EXPECT_EQ(station_.receive(received_, 1'000'000'000), 0U);
    EXPECT_EQ(station_.health().link, link);
    bus_.set_link(LinkState::Up);
    EXPECT_TRUE(station_.send(numbered(1), 0));
  }
  EXPECT_EQ(station_.health().send_failures, 3U);
  EXPECT_EQ(station_.health().bus_off_events, 1U);
}

}  // namespace
}  // namespace clampd::can
