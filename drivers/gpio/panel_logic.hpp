#pragma once

// What the operator's panel means, without any line: time is an argument, so that tests run it in virtual
// time.

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include "clampd/base/clock.hpp"
#include "clampd/ports/interlocks.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/record/sample.hpp"

namespace clampd::gpio {

enum class LineRole : std::uint8_t {
  EmergencyStop,  ///< input, normally closed: an open line is a pressed button or a wire that is off
  FixtureClosed,  ///< input, closed while the fixture is
  StartButton,    ///< input, closed while it is pressed
  EnableRelay,    ///< output, to be wired normally open: without current the drive cannot drive
  LightRed,
  LightAmber,
  LightGreen,
};
inline constexpr std::size_t kLineRoles = 7;
inline constexpr std::size_t kInputRoles = 3;        ///< the first ones
std::string_view to_string(LineRole role) noexcept;  ///< "emergency stop", "fixture closed", ...

/// A debounced contact. It is believed to have closed (opened) once it stayed so for the closing (opening)
/// time, counted from the edge's own time stamp; a time of zero believes the edge itself. The first level fed
/// is believed at once.
class Contact {
 public:
  Contact(std::int64_t closing_ns, std::int64_t opening_ns) noexcept
      : closing_ns_(closing_ns), opening_ns_(opening_ns) {}

  /// The contact is `closed` from `stamp_ns` on; stamps that go back count as the latest one.
  void feed(bool closed, std::int64_t stamp_ns) noexcept;
  bool closed(std::int64_t now_ns) noexcept;
  /// When the level came that was seen last.
  std::int64_t since_ns() const noexcept { return level_since_ns_; }

 private:
  void settle(std::int64_t now_ns) noexcept;

  std::int64_t closing_ns_;
  std::int64_t opening_ns_;
  bool known_ = false;
  bool level_ = false;
  std::int64_t level_since_ns_ = 0;
  bool closed_ = false;
};

/// Reports each press once, and a button that is stuck: closed when it was first seen, or for longer than
/// anybody presses.
class StartButton {
 public:
  StartButton(std::int64_t debounce_ns, std::int64_t stuck_after_ns) noexcept
      : contact_(debounce_ns, debounce_ns), stuck_after_ns_(stuck_after_ns) {}

  void feed(bool closed, std::int64_t stamp_ns) noexcept { contact_.feed(closed, stamp_ns); }
  /// The stamp of its edge if it was pressed since the last call. Calls come in order of time, after the
  /// first feed().
  std::optional<std::int64_t> pressed(std::int64_t now_ns) noexcept;
  bool stuck() const noexcept { return stuck_; }

 private:
  Contact contact_;
  std::int64_t stuck_after_ns_;
  bool known_ = false;
  bool was_closed_ = false;
  bool stuck_ = false;
  std::int64_t closed_since_ns_ = 0;
};

/// A press that nobody took for longer is none: whoever pressed no longer expects the brake to move.
inline constexpr std::int64_t kPressLife_ns = 200 * kNanosecondsPerMillisecond;

/// The last press of the start button on its way from who sees it to who starts the check. Any thread.
class StartPress {
 public:
  struct Press {
    std::int64_t stamp_ns = 0;
    bool blocked = false;  ///< by an interlock: it starts nothing
  };

  void note(std::int64_t stamp_ns) noexcept { word_ = stamp_ns << 1; }
  /// An interlock stands against whatever was pressed until now.
  void block() noexcept { word_.fetch_or(1); }
  /// Each press once, while it lives.
  std::optional<Press> take(std::int64_t now_ns) noexcept {
    const std::int64_t word = word_.exchange(kNone);
    const Press press{word >> 1, (word & 1) != 0};
    if (word == kNone || now_ns - press.stamp_ns > kPressLife_ns) return std::nullopt;
    return press;
  }

 private:
  static constexpr std::int64_t kNone = -1;  // stays what it is when blocked
  std::atomic<std::int64_t> word_{kNone};    // the stamp, and in the lowest bit whether it is blocked
};

/// The relay carries current only while a check may drive: ARMED, RUNNING, RELEASING. Not in IDLE, where
/// hands are in the fixture.
bool may_drive(StationState state) noexcept;

/// When the enable relay is energised: in a state that may drive, as long as the loop's tick counter moves.
class RelayGate {
 public:
  explicit RelayGate(std::int64_t watchdog_ns) noexcept : watchdog_ns_(watchdog_ns) {}
  bool energised(const LoopBeat& beat, std::int64_t now_ns) noexcept;

 private:
  std::int64_t watchdog_ns_;
  bool moved_ = false;  ///< a counter that was never seen to move is none
  bool known_ = false;
  std::uint64_t ticks_ = 0;
  std::int64_t ticked_ns_ = 0;
};

/// What the stack light tells.
enum class Sign : std::uint8_t {
  Starting,
  Ready,
  Running,
  Concluding,
  Passed,
  Failed,
  Invalid,
  Fault,
  Clamped
};

/// What the lights show beside the state.
struct Outlook {
  bool concluding = false;      ///< the brake is done, the verdict not yet
  std::optional<Verdict> last;  ///< of the last check, if none came after it
  bool clamped = false;         ///< force stands on the brake though nothing drives it
};

Sign sign_of(StationState state, const Outlook& outlook) noexcept;

enum class Lamp : std::uint8_t { Off, On, Blink };
struct StackLight {
  Lamp red;
  Lamp amber;
  Lamp green;
};
StackLight stack_light(Sign sign) noexcept;
/// Blinking is once a second, half of it on.
bool is_lit(Lamp lamp, std::int64_t now_ns) noexcept;

}  // namespace clampd::gpio
