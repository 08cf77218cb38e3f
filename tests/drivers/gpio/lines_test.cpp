// What can be said of lines on a machine without any GPIO chip; the virtual bench (hil.gpio_vcan) has one.

#include "drivers/gpio/lines.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"
#include "drivers/gpio/panel.hpp"
#include "drivers/gpio/relay_guard.hpp"

namespace clampd::gpio {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

LineSettings missing_line() {
  LineSettings settings;
  settings.chip = "no-such-chip";
  settings.line = "4";
  return settings;
}

PanelSettings panel_settings() {
  PanelSettings settings;
  settings.lines[0] = missing_line();
  settings.poll_ns = kNanosecondsPerMillisecond;
  settings.lost_after_ns = 5 * kNanosecondsPerMillisecond;
  settings.relay_watchdog_ns = 10 * kNanosecondsPerMillisecond;
  return settings;
}

TEST(Lines, AreNamedByChipLineAndPurpose) {
  EXPECT_EQ(describe({"gpiochip0", "4", false, Bias::AsIs}, LineRole::EmergencyStop),
            "gpiochip0 line 4 (emergency stop)");
  EXPECT_EQ(describe({"", "ESTOP", false, Bias::AsIs}, LineRole::EmergencyStop),
            "line ESTOP (emergency stop)");
}

TEST(Lines, AMissingChipIsNamed) {
  const auto named = AllOf(HasSubstr("no-such-chip line 4 (start button)"), HasSubstr("no such chip"));
  EXPECT_THAT(Line::open_input(missing_line(), LineRole::StartButton).error().message, named);
  EXPECT_THAT(Line::open_output(missing_line(), LineRole::StartButton, false).error().message, named);
  EXPECT_THAT(inspect_line(missing_line(), LineRole::StartButton).error().message, named);
  LineSettings by_name;
  by_name.line = "NO-SUCH-LINE";
  EXPECT_THAT(Line::open_input(by_name, LineRole::StartButton).error().message,
              HasSubstr("line NO-SUCH-LINE (start button)"));
}

TEST(Panel, DoesNotOpenWithoutItsLines) {
  const auto panel = Panel::open(panel_settings());
  ASSERT_FALSE(panel);
  EXPECT_THAT(panel.error().message, HasSubstr("no-such-chip line 4 (emergency stop)"));
}

TEST(Panel, TheRelaysGuardSaysWhyItCannotStart) {
  PanelSettings settings = panel_settings();
  settings.lines[static_cast<std::size_t>(LineRole::EnableRelay)] = missing_line();
  const auto panel = Panel::open(settings);
  ASSERT_FALSE(panel);
  EXPECT_THAT(panel.error().message, HasSubstr("no-such-chip line 4 (enable relay)"));
}

}  // namespace
}  // namespace clampd::gpio
