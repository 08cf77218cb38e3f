#include "drivers/gpio/panel_logic.hpp"

#include <algorithm>
#include <array>

#include "clampd/base/clock.hpp"

namespace clampd::gpio {

namespace {

/// THE table of the stack light, indexed by Sign.
constexpr std::array<StackLight, 9> kStackLights{{
    {Lamp::Off, Lamp::Blink, Lamp::Off},    // Starting
    {Lamp::Off, Lamp::Off, Lamp::On},       // Ready
    {Lamp::Off, Lamp::On, Lamp::Off},       // Running
    {Lamp::Off, Lamp::Blink, Lamp::Off},    // Concluding
    {Lamp::Off, Lamp::Off, Lamp::On},       // Passed
    {Lamp::On, Lamp::Off, Lamp::Off},       // Failed
    {Lamp::Blink, Lamp::Off, Lamp::Off},    // Invalid: no verdict about the brake
    {Lamp::Blink, Lamp::Blink, Lamp::Off},  // Fault
    {Lamp::On, Lamp::Blink, Lamp::Off}      // Clamped: keep hands away, `clampctl open`
}};

}  // namespace

std::string_view to_string(LineRole role) noexcept {
  switch (role) {
    case LineRole::EmergencyStop:
      return "emergency stop";
    case LineRole::FixtureClosed:
      return "fixture closed";
    case LineRole::StartButton:
      return "start button";
    case LineRole::EnableRelay:
      return "enable relay";
    case LineRole::LightRed:
      return "red light";
    case LineRole::LightAmber:
      return "amber light";
    case LineRole::LightGreen:
      return "green light";
  }
  return "?";
}

void Contact::feed(bool closed, std::int64_t stamp_ns) noexcept {
  if (!known_) {
    known_ = true;
    level_ = closed_ = closed;
    level_since_ns_ = stamp_ns;
    return;
  }
  stamp_ns = std::max(stamp_ns, level_since_ns_);
  settle(stamp_ns);
  if (closed != level_) {
    level_ = closed;
    level_since_ns_ = stamp_ns;
  }
  settle(stamp_ns);
}

bool Contact::closed(std::int64_t now_ns) noexcept {
  settle(now_ns);
  return closed_;
}

void Contact::settle(std::int64_t now_ns) noexcept {
  if (level_ != closed_ && now_ns - level_since_ns_ >= (level_ ? closing_ns_ : opening_ns_)) closed_ = level_;
}

std::optional<std::int64_t> StartButton::pressed(std::int64_t now_ns) noexcept {
  const bool closed = contact_.closed(now_ns);
  const bool press = closed && !was_closed_ && known_;
  if (closed && !was_closed_) {
    closed_since_ns_ = now_ns;
    stuck_ = !known_;
  }
  if (closed && now_ns - closed_since_ns_ > stuck_after_ns_) stuck_ = true;
  if (!closed) stuck_ = false;
  known_ = true;
  was_closed_ = closed;
  return press ? std::optional(contact_.since_ns()) : std::nullopt;
}

bool may_drive(StationState state) noexcept {
  return state == StationState::Armed || state == StationState::Running || state == StationState::Releasing;
}

bool RelayGate::energised(const LoopBeat& beat, std::int64_t now_ns) noexcept {
  if (!known_ || beat.ticks != ticks_) {
    moved_ = known_;
    known_ = true;
    ticks_ = beat.ticks;
    ticked_ns_ = now_ns;
  }
  return moved_ && now_ns - ticked_ns_ < watchdog_ns_ && may_drive(beat.state);
}

Sign sign_of(StationState state, const Outlook& outlook) noexcept {
  if (state == StationState::Fault) return Sign::Fault;
  if (may_drive(state)) return Sign::Running;
  if (outlook.clamped) return Sign::Clamped;
  if (outlook.concluding) return Sign::Concluding;
  if (state == StationState::Init) return Sign::Starting;
  if (!outlook.last) return Sign::Ready;
  switch (*outlook.last) {
    case Verdict::Pass:
      return Sign::Passed;
    case Verdict::Fail:
      return Sign::Failed;
    case Verdict::Error:
    case Verdict::Timeout:
    case Verdict::Aborted:
      break;
  }
  return Sign::Invalid;
}

StackLight stack_light(Sign sign) noexcept {
  return kStackLights[static_cast<std::size_t>(sign)];
}

bool is_lit(Lamp lamp, std::int64_t now_ns) noexcept {
  return lamp == Lamp::On ||
         (lamp == Lamp::Blink && now_ns % kNanosecondsPerSecond < kNanosecondsPerSecond / 2);
}

}  // namespace clampd::gpio
