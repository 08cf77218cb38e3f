// The panel in virtual time.

#include "drivers/gpio/panel_logic.hpp"

#include <optional>
#include <set>
#include <string>
#include <tuple>

#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"

namespace clampd::gpio {
namespace {

constexpr std::int64_t kMs = kNanosecondsPerMillisecond;

TEST(Contact, BelievesItsFirstLevelAtOnce) {
  for (const bool closed : {true, false}) {
    Contact contact(20 * kMs, 20 * kMs);
    contact.feed(closed, 1000 * kMs);
    EXPECT_EQ(contact.closed(1000 * kMs), closed);
  }
}

TEST(Contact, ABouncingContactClosesOnceAfterItsLastEdge) {
  Contact contact(20 * kMs, 20 * kMs);
  contact.feed(false, 0);
  int changes = 0;
  bool before = false;
  std::int64_t closed_at = 0;
  for (std::int64_t t = kMs; t < 200 * kMs; t += kMs / 4) {
    const bool bouncing = t < 15 * kMs;
    contact.feed(bouncing ? (t / (kMs / 4)) % 2 == 0 : true, t);
    if (contact.closed(t) != before) {
      before = !before;
      ++changes;
      closed_at = t;
    }
  }
  EXPECT_EQ(changes, 1);
  EXPECT_GE(closed_at, 34 * kMs);
  EXPECT_LE(closed_at, 36 * kMs);
}

TEST(Contact, CountsFromTheEdgeAndNotFromWhenItWasLookedAt) {
  Contact contact(20 * kMs, 20 * kMs);
  contact.feed(false, 0);
  contact.feed(true, 100 * kMs);
  EXPECT_FALSE(contact.closed(119 * kMs));
  EXPECT_TRUE(contact.closed(120 * kMs));
}

TEST(Contact, AGlitchShorterThanItsTimeIsNothing) {
  Contact contact(20 * kMs, 20 * kMs);
  contact.feed(true, 0);
  contact.feed(false, 100 * kMs);
  contact.feed(true, 119 * kMs);
  for (std::int64_t t = 119 * kMs; t < 300 * kMs; t += kMs) EXPECT_TRUE(contact.closed(t));
}

TEST(Contact, AnOpeningTimeOfZeroBelievesTheEdgeItself) {
  Contact contact(50 * kMs, 0);
  contact.feed(true, 0);
  contact.feed(false, 100 * kMs);
  EXPECT_FALSE(contact.closed(100 * kMs));
}

TEST(Contact, APulseBetweenTwoLooksStillOpensAnEmergencyStop) {
  Contact contact(50 * kMs, 0);
  contact.feed(true, 0);
  contact.feed(false, 100 * kMs);
  contact.feed(true, 100 * kMs + 1000);
  EXPECT_FALSE(contact.closed(101 * kMs)) << "it stays open until it was closed for the closing time";
  EXPECT_FALSE(contact.closed(149 * kMs));
  EXPECT_TRUE(contact.closed(151 * kMs));
}

TEST(Contact, ABouncingReleaseKeepsAnEmergencyStopOpen) {
  Contact contact(50 * kMs, 0);
  contact.feed(false, 0);
  for (std::int64_t t = kMs; t < 40 * kMs; t += kMs) {
    contact.feed((t / kMs) % 2 == 1, t);
    EXPECT_FALSE(contact.closed(t));
  }
  contact.feed(true, 40 * kMs);
  EXPECT_FALSE(contact.closed(88 * kMs));
  EXPECT_TRUE(contact.closed(90 * kMs));
}

TEST(Contact, AStampFromBeforeTheLastOneDoesNotTurnTimeBack) {
  Contact contact(20 * kMs, 20 * kMs);
  contact.feed(false, 0);
  contact.feed(true, 100 * kMs);
  contact.feed(false, 90 * kMs);
  contact.feed(true, 95 * kMs);
  EXPECT_FALSE(contact.closed(119 * kMs));
  EXPECT_TRUE(contact.closed(120 * kMs));
}

/// Feeds the level every millisecond; returns how many presses were reported.
int hold(StartButton& button, bool closed, std::int64_t& now_ns, std::int64_t for_ns) {
  int presses = 0;
  for (const std::int64_t end = now_ns + for_ns; now_ns < end; now_ns += kMs) {
    button.feed(closed, now_ns);
    presses += button.pressed(now_ns) ? 1 : 0;
  }
  return presses;
}

TEST(StartButton, StampsAPressWhereItsEdgeWasSeen) {
  StartButton button(20 * kMs, 10'000 * kMs);
  button.feed(false, 100 * kMs);
  EXPECT_FALSE(button.pressed(100 * kMs));
  button.feed(true, 150 * kMs);
  EXPECT_FALSE(button.pressed(160 * kMs)) << "not debounced yet";
  EXPECT_EQ(button.pressed(190 * kMs), 150 * kMs);
  EXPECT_FALSE(button.pressed(191 * kMs));
}

TEST(StartPress, LivesForAMomentAndIsTakenOnce) {
  StartPress press;
  EXPECT_FALSE(press.take(0));
  press.note(1'000 * kMs);
  const auto taken = press.take(1'200 * kMs);
  ASSERT_TRUE(taken);
  EXPECT_EQ(taken->stamp_ns, 1'000 * kMs);
  EXPECT_FALSE(taken->blocked);
  EXPECT_FALSE(press.take(1'200 * kMs));
  press.note(2'000 * kMs);
  EXPECT_FALSE(press.take(2'201 * kMs)) << "as after a save that blocked";
  EXPECT_FALSE(press.take(2'100 * kMs)) << "gone for good";
}

TEST(StartPress, IsBlockedByAnInterlockThatCameAfterIt) {
  StartPress press;
  press.block();
  EXPECT_FALSE(press.take(0));
  press.note(1'000 * kMs);
  press.block();
  const auto blocked = press.take(1'001 * kMs);
  ASSERT_TRUE(blocked) << "so that somebody can say why nothing happened";
  EXPECT_EQ(blocked->stamp_ns, 1'000 * kMs);
  EXPECT_TRUE(blocked->blocked);
  press.note(1'500 * kMs);
  EXPECT_FALSE(press.take(1'501 * kMs)->blocked);
}

TEST(StartButton, ReportsEachPressOnce) {
  StartButton button(20 * kMs, 10'000 * kMs);
  std::int64_t now_ns = 5 * kMs;
  EXPECT_EQ(hold(button, false, now_ns, 100 * kMs), 0);
  for (int press = 0; press < 3; ++press) {
    EXPECT_EQ(hold(button, true, now_ns, 300 * kMs), 1);
    EXPECT_FALSE(button.stuck());
    EXPECT_EQ(hold(button, false, now_ns, 100 * kMs), 0);
  }
  EXPECT_EQ(hold(button, true, now_ns, 10 * kMs), 0) << "shorter than the debounce time";
  EXPECT_EQ(hold(button, false, now_ns, 100 * kMs), 0);
}

TEST(StartButton, HeldAtStartUpIsStuckAndNoPress) {
  StartButton button(20 * kMs, 10'000 * kMs);
  std::int64_t now_ns = 5 * kMs;
  EXPECT_EQ(hold(button, true, now_ns, 5 * kMs), 0);
  EXPECT_TRUE(button.stuck());
  EXPECT_EQ(hold(button, true, now_ns, 20'000 * kMs), 0);
  EXPECT_TRUE(button.stuck());
  EXPECT_EQ(hold(button, false, now_ns, 100 * kMs), 0);
  EXPECT_FALSE(button.stuck());
  EXPECT_EQ(hold(button, true, now_ns, 100 * kMs), 1);
}

TEST(StartButton, HeldTooLongIsStuckUntilItIsFree) {
  StartButton button(20 * kMs, 10'000 * kMs);
  std::int64_t now_ns = 5 * kMs;
  hold(button, false, now_ns, 100 * kMs);
  EXPECT_EQ(hold(button, true, now_ns, 9'900 * kMs), 1);
  EXPECT_FALSE(button.stuck());
  EXPECT_EQ(hold(button, true, now_ns, 200 * kMs), 0);
  EXPECT_TRUE(button.stuck());
  hold(button, false, now_ns, 30 * kMs);
  EXPECT_FALSE(button.stuck());
}

constexpr StationState kEveryState[] = {StationState::Init,    StationState::Idle,      StationState::Armed,
                                        StationState::Running, StationState::Releasing, StationState::Fault};

TEST(RelayGate, IsEnergisedInStatesThatMayDriveOnly) {
  for (const StationState state : kEveryState) {
    RelayGate gate(10 * kMs);
    bool on = false;
    for (std::uint64_t tick = 0; tick < 50; ++tick)
      on = gate.energised({tick, state}, static_cast<std::int64_t>(tick) * kMs);
    EXPECT_EQ(on, state == StationState::Armed || state == StationState::Running ||
                      state == StationState::Releasing)
        << to_string(state);
  }
}

TEST(RelayGate, DropsWhenTheTickCounterStandsStillAndComesBackWithIt) {
  RelayGate gate(10 * kMs);
  std::int64_t now_ns = 0;
  std::uint64_t ticks = 0;
  const auto run = [&](int looks, bool ticking) {
    bool on = false;
    for (int i = 0; i < looks; ++i, now_ns += 2 * kMs) {
      if (ticking) ticks += 2;
      on = gate.energised({ticks, StationState::Running}, now_ns);
    }
    return on;
  };
  EXPECT_TRUE(run(20, true));
  EXPECT_TRUE(run(4, false)) << "8 ms";
  EXPECT_FALSE(run(1, false)) << "10 ms";
  EXPECT_FALSE(run(1000, false));
  EXPECT_TRUE(run(1, true));
}

TEST(RelayGate, ACounterThatNeverMovedIsNoLoop) {
  RelayGate gate(10 * kMs);
  EXPECT_FALSE(gate.energised({7, StationState::Running}, 0));
  EXPECT_FALSE(gate.energised({7, StationState::Running}, kMs));
  EXPECT_TRUE(gate.energised({8, StationState::Running}, 2 * kMs));
}

TEST(RelayGate, DropsInTheLookThatSeesAFault) {
  RelayGate gate(10 * kMs);
  for (std::uint64_t tick = 0; tick < 10; ++tick)
    gate.energised({tick, StationState::Running}, static_cast<std::int64_t>(tick) * kMs);
  EXPECT_FALSE(gate.energised({11, StationState::Fault}, 11 * kMs));
}

TEST(StackLight, TellsEverySignApartAndIsNeverDark) {
  std::set<std::tuple<Lamp, Lamp, Lamp>> seen;
  for (int i = 0; i <= static_cast<int>(Sign::Clamped); ++i) {
    const StackLight light = stack_light(static_cast<Sign>(i));
    EXPECT_TRUE(light.red != Lamp::Off || light.amber != Lamp::Off || light.green != Lamp::Off) << i;
    seen.emplace(light.red, light.amber, light.green);
  }
  // Ready and passed are both green; starting and concluding both ask to wait.
  EXPECT_EQ(seen.size(), 7U);
}

TEST(StackLight, GreenMeansReadyOrPassedAndNothingElse) {
  const std::optional<Verdict> verdicts[] = {std::nullopt,   Verdict::Pass,    Verdict::Fail,
                                             Verdict::Error, Verdict::Timeout, Verdict::Aborted};
  for (const StationState state : kEveryState) {
    for (const bool concluding : {false, true}) {
      for (const std::optional<Verdict> last : verdicts) {
        const StackLight light = stack_light(sign_of(state, {concluding, last, false}));
        const bool good = state == StationState::Idle && !concluding && (!last || *last == Verdict::Pass);
        EXPECT_EQ(light.green == Lamp::On, good) << to_string(state) << concluding;
        const bool bad = state == StationState::Fault ||
                         (state == StationState::Idle && !concluding && last && *last != Verdict::Pass);
        EXPECT_EQ(light.red != Lamp::Off, bad) << to_string(state) << concluding;
      }
    }
  }
}

TEST(StackLight, AClampedBrakeIsShownWheneverNothingDrives) {
  for (const StationState state : kEveryState)
    for (const bool concluding : {false, true}) {
      const Sign sign = sign_of(state, {concluding, Verdict::Pass, true});
      const Sign expected = state == StationState::Fault ? Sign::Fault
                            : may_drive(state)           ? Sign::Running
                                                         : Sign::Clamped;
      EXPECT_EQ(sign, expected) << to_string(state);
      EXPECT_NE(stack_light(sign).green, Lamp::On) << "hands off";
    }
}

TEST(StackLight, BlinksOnceASecond) {
  EXPECT_TRUE(is_lit(Lamp::Blink, 7'000 * kMs));
  EXPECT_TRUE(is_lit(Lamp::Blink, 7'499 * kMs));
  EXPECT_FALSE(is_lit(Lamp::Blink, 7'500 * kMs));
  EXPECT_TRUE(is_lit(Lamp::On, 7'500 * kMs));
  EXPECT_FALSE(is_lit(Lamp::Off, 7'000 * kMs));
}

TEST(LineRole, EveryRoleHasAnOwnName) {
  std::set<std::string> names;
  for (std::size_t i = 0; i < kLineRoles; ++i) names.emplace(to_string(static_cast<LineRole>(i)));
  EXPECT_EQ(names.size(), kLineRoles);
  EXPECT_EQ(names.count("?"), 0U);
}

}  // namespace
}  // namespace clampd::gpio
