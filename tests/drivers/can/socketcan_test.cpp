#include "drivers/can/socketcan.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/can.h>
#include <linux/can/error.h>

#include <array>
#include <cstdlib>
#include <memory>
#include <string>

#include "clampd/base/clock.hpp"

namespace clampd::can {
namespace {

using ::testing::AnyOf;
using ::testing::HasSubstr;

can_frame error_frame(std::uint32_t classes, std::uint8_t controller = 0) {
  can_frame frame{};
  frame.can_id = CAN_ERR_FLAG | classes;
  frame.can_dlc = CAN_ERR_DLC;
  frame.data[1] = controller;
  return frame;
}

TEST(ErrorFrames, BusOffLastsUntilTheRestartIsReported) {
  BusHealth health;
  apply_error_frame(error_frame(CAN_ERR_BUSOFF), health);
  EXPECT_EQ(health.link, LinkState::BusOff);
  apply_error_frame(error_frame(CAN_ERR_CRTL, CAN_ERR_CRTL_TX_PASSIVE), health);
  EXPECT_EQ(health.link, LinkState::BusOff);
  apply_error_frame(error_frame(CAN_ERR_RESTARTED), health);
  EXPECT_EQ(health.link, LinkState::Up);
  EXPECT_EQ(health.bus_off_events, 1U);
  EXPECT_EQ(health.error_frames, 3U);
}

TEST(ErrorFrames, PassiveAndBack) {
  BusHealth health;
  apply_error_frame(error_frame(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_WARNING), health);
  EXPECT_EQ(health.link, LinkState::Up);
  apply_error_frame(error_frame(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_PASSIVE), health);
  EXPECT_EQ(health.link, LinkState::ErrorPassive);
  apply_error_frame(error_frame(CAN_ERR_PROT | CAN_ERR_BUSERROR), health);
  EXPECT_EQ(health.link, LinkState::ErrorPassive);
  apply_error_frame(error_frame(CAN_ERR_CRTL, CAN_ERR_CRTL_ACTIVE), health);
  EXPECT_EQ(health.link, LinkState::Up);
}

TEST(ErrorFrames, ControllerOverflowsAreLostFrames) {
  BusHealth health;
  apply_error_frame(error_frame(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_OVERFLOW), health);
  EXPECT_EQ(health.receive_overflows, 1U);
  EXPECT_EQ(health.link, LinkState::Up);
}

TEST(Interface, AMissingOneSaysHowToMakeIt) {
  for (const char* name : {"nocan7", "", "a-name-longer-than-any-interface"}) {
    const auto info = inspect_interface(name);
    ASSERT_FALSE(info);
    EXPECT_THAT(info.error().message, HasSubstr("there is no CAN interface"));
    EXPECT_THAT(info.error().message, HasSubstr("ip link add"));
  }
}

TEST(Interface, OneThatIsNotCanIsRefused) {
  const auto info = inspect_interface("lo");
  ASSERT_FALSE(info);
  EXPECT_THAT(info.error().message, HasSubstr("lo is not a CAN interface"));
}

TEST(Interface, OpeningSaysWhatIsMissing) {
  const auto bus = SocketCanBus::open("nocan7", {0x180});
  ASSERT_FALSE(bus);
  if (kernel_has_can()) {
    EXPECT_THAT(bus.error().message, HasSubstr("there is no CAN interface nocan7"));
  } else {
    EXPECT_THAT(bus.error().message, HasSubstr("this kernel gives no raw CAN socket"));
    EXPECT_THAT(bus.error().message, HasSubstr("modprobe can-raw"));
  }
}

/// Two sockets on one real interface, named by CLAMPD_TEST_CAN: a vcan that is up, and that the tests may
/// take down and remove.
class RealBus : public ::testing::Test {
 protected:
  void SetUp() override {
    const char* interface = std::getenv("CLAMPD_TEST_CAN");
    if (interface == nullptr)
      GTEST_SKIP() << "set CLAMPD_TEST_CAN to a vcan interface that is up and may be removed";
    interface_ = interface;
    auto a = SocketCanBus::open(interface, {0x180, kExtendedId | 0x181});
    auto b = SocketCanBus::open(interface, {0x100});
    ASSERT_TRUE(a) << a.error().message;
    ASSERT_TRUE(b) << b.error().message;
    station_ = std::move(*a);
    brake_ = std::move(*b);
  }

  void ip_link(const std::string& arguments) {
    ASSERT_EQ(std::system(("ip link " + arguments).c_str()), 0) << arguments;
  }

  std::string interface_;
  std::unique_ptr<SocketCanBus> station_;
  std::unique_ptr<SocketCanBus> brake_;
  std::array<TimedFrame, 8> received_;
};

TEST_F(RealBus, WantedFramesArriveWithTheirTime) {
  const std::int64_t before_ns = monotonic_now_ns();
  EXPECT_TRUE(brake_->send(Frame{0x180, 3, {1, 2, 3}}, before_ns));
  EXPECT_TRUE(brake_->send(Frame{0x181, 1, {9}}, before_ns)) << "not wanted: only the 29-bit 0x181 is";
  EXPECT_TRUE(brake_->send(Frame{kExtendedId | 0x181, 8, {4}}, before_ns));
  const std::int64_t now_ns = monotonic_now_ns();
  ASSERT_EQ(station_->receive(received_, now_ns), 2U);
  EXPECT_EQ(received_[0].frame, (Frame{0x180, 3, {1, 2, 3}}));
  EXPECT_EQ(received_[1].frame, (Frame{kExtendedId | 0x181, 8, {4}}));
  // Two clocks are read one after the other for the conversion: allow for a preemption between them.
  EXPECT_NEAR(static_cast<double>(received_[0].arrival_ns - before_ns), 0.0, 1e9);
  EXPECT_EQ(station_->health().frames_received, 2U);
  EXPECT_EQ(brake_->health().frames_sent, 3U);
  EXPECT_EQ(station_->receive(received_, now_ns), 0U);
  EXPECT_EQ(brake_->receive(received_, now_ns), 0U) << "not its own";
}

TEST_F(RealBus, ErrorFramesOfTheBusReachEverySocket) {
  EXPECT_TRUE(brake_->send(Frame{CAN_ERR_FLAG | CAN_ERR_BUSOFF, 8, {}}, 0));
  EXPECT_EQ(station_->receive(received_, 0), 0U);
  EXPECT_EQ(station_->health().link, LinkState::BusOff);
  EXPECT_EQ(station_->health().bus_off_events, 1U);
  EXPECT_TRUE(brake_->send(Frame{0x180, 0, {}}, 0));
  EXPECT_EQ(station_->receive(received_, 0), 1U);
  EXPECT_EQ(station_->health().link, LinkState::Up) << "a frame from the bus proves that we are on it";
}

TEST_F(RealBus, TheKernelsDropsAreCounted) {
  constexpr int kFrames = 4000;  // more than a receive buffer of the usual size holds
  for (int i = 0; i < kFrames; ++i) brake_->send(Frame{0x180, 8, {}}, 0);
  std::size_t got = 0;
  while (const std::size_t count = station_->receive(received_, 0)) got += count;
  // The count of drops comes with the next frame that finds room.
  brake_->send(Frame{0x180, 8, {}}, 0);
  got += station_->receive(received_, 0);
  EXPECT_LT(got, kFrames);
  EXPECT_EQ(got + station_->health().receive_overflows, kFrames + 1U);
}

TEST_F(RealBus, AnInterfaceThatGoesDownComesBackByItself) {
  ip_link("set " + interface_ + " down");
  EXPECT_EQ(station_->receive(received_, 0), 0U);
  EXPECT_EQ(station_->health().link, LinkState::Down) << "known without sending";
  EXPECT_FALSE(brake_->send(Frame{0x180, 1, {}}, 0));
  EXPECT_EQ(brake_->health().link, LinkState::Down);
  EXPECT_EQ(brake_->health().send_failures, 1U);
  EXPECT_FALSE(inspect_interface(interface_)->up);
  EXPECT_TRUE(SocketCanBus::open(interface_, {1})) << "one may open before it is up";
  ip_link("set " + interface_ + " up");
  // A socket that still holds the unread error of going down reports it once.
  brake_->send(Frame{0x180, 1, {}}, 0);
  EXPECT_TRUE(brake_->send(Frame{0x180, 1, {}}, 0));
  EXPECT_EQ(brake_->health().link, LinkState::Up);
  EXPECT_GE(station_->receive(received_, 0), 1U);
  EXPECT_EQ(station_->health().link, LinkState::Up);
}

TEST_F(RealBus, AVanishedInterfaceIsFoundAgainBehindTheSameSocket) {
  EXPECT_TRUE(station_->reopen()) << "nothing to do";
  ip_link("del " + interface_);
  EXPECT_EQ(station_->receive(received_, 0), 0U);
  EXPECT_EQ(station_->link(), LinkState::Gone) << "known without sending";
  brake_->send(Frame{0x180, 1, {}}, 0);
  EXPECT_FALSE(brake_->send(Frame{0x180, 1, {}}, 0));
  EXPECT_EQ(brake_->link(), LinkState::Gone);
  const auto missing = station_->reopen();
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().message, HasSubstr("there is no CAN interface"));

  ip_link("add " + interface_ + " type vcan");
  ip_link("set " + interface_ + " up");
  EXPECT_FALSE(brake_->send(Frame{0x180, 1, {}}, 0)) << "a new interface needs a new socket";
  EXPECT_EQ(brake_->link(), LinkState::Gone);
  ASSERT_TRUE(station_->reopen());
  ASSERT_TRUE(brake_->reopen());
  EXPECT_TRUE(brake_->send(Frame{0x180, 1, {7}}, 0));
  EXPECT_TRUE(brake_->send(Frame{0x100, 1, {7}}, 0)) << "the filters are in force again";
  ASSERT_EQ(station_->receive(received_, 0), 1U);
  EXPECT_EQ(received_[0].frame.data[0], 7);
  EXPECT_EQ(station_->link(), LinkState::Up);
  EXPECT_EQ(brake_->link(), LinkState::Up);
}

TEST_F(RealBus, TheInterfaceIsDescribed) {
  const auto info = inspect_interface(interface_);
  ASSERT_TRUE(info) << info.error().message;
  EXPECT_TRUE(info->up);
  EXPECT_THAT(info->kind, AnyOf("vcan", "vxcan", "can"));
  EXPECT_EQ(info->bitrate == 0, info->kind != "can");
}

}  // namespace
}  // namespace clampd::can
