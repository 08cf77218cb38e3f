#include "drivers/gpio/panel.hpp"

#include <poll.h>
#include <pthread.h>

#include <cerrno>
#include <cstring>
#include <ctime>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"

namespace clampd::gpio {

namespace {

constexpr std::array kLights{LineRole::LightRed, LineRole::LightAmber, LineRole::LightGreen};
constexpr std::int64_t kReopenEvery_ns = 500 * kNanosecondsPerMillisecond;
constexpr int kEdgesPerRound = 16;  // a chattering contact must not keep the levels from being read
constexpr std::int64_t kGuardSilent_ns = 20 * kNanosecondsPerMillisecond;

constexpr std::size_t index(LineRole role) {
  return static_cast<std::size_t>(role);
}

bool is_input(LineRole role) {
  return index(role) < kInputRoles;
}

Result<void> make_realtime(std::thread& thread, int priority) {
  if (priority <= 0) return {};
  sched_param parameters{};
  parameters.sched_priority = priority;
  const int error = pthread_setschedparam(thread.native_handle(), SCHED_FIFO, &parameters);
  if (error == 0) return {};
  return failure(
      fmt::format("panel: no right to SCHED_FIFO priority {} ({}); raise RLIMIT_RTPRIO (LimitRTPRIO in the "
                  "systemd unit), or "
                  "set [realtime] priority = 0 for development",
                  priority, std::strerror(error)));
}

}  // namespace

Panel::Panel(const PanelSettings& settings, SharedMemory memory)
    : settings_(settings),
      memory_(std::move(memory)),
      emergency_stop_(settings.release_ns, 0),
      fixture_(settings.debounce_ns, settings.debounce_ns),
      start_button_(settings.debounce_ns, settings.stuck_after_ns) {}

Result<std::unique_ptr<Panel>> Panel::open(const PanelSettings& settings) {
  Result<SharedMemory> memory = share_memory(settings.lost_after_ns);
  if (!memory) return tl::unexpected(memory.error());
  std::unique_ptr<Panel> panel(new Panel(settings, std::move(*memory)));
  if (panel->has(LineRole::EnableRelay)) {
    const int priority = settings.loop_priority > 0 ? settings.loop_priority + 1 : 0;
    auto guard = RelayGuard::start(
        {settings.line(LineRole::EnableRelay), settings.relay_watchdog_ns, priority}, *panel->memory_);
    if (!guard) return tl::unexpected(guard.error());
    panel->guard_ = std::move(*guard);
  }
  if (Result<void> opened = panel->open_lines(); !opened) return tl::unexpected(opened.error());
  return panel;
}

Panel::~Panel() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
  for (const LineRole light : kLights)
    if (lines_[index(light)]) lines_[index(light)]->set(false);
}

Result<void> Panel::open_lines() {
  close_lines();
  for (std::size_t i = 0; i < kLineRoles; ++i) {
    const auto role = static_cast<LineRole>(i);
    if (!has(role) || role == LineRole::EnableRelay) continue;
    Result<Line> line = is_input(role) ? Line::open_input(settings_.lines[i], role)
                                       : Line::open_output(settings_.lines[i], role, false);
    if (!line) return tl::unexpected(line.error());
    lines_[i].emplace(std::move(*line));
  }
  lit_ = {};
  emergency_stop_ = Contact(settings_.release_ns, 0);
  fixture_ = Contact(settings_.debounce_ns, settings_.debounce_ns);
  start_button_ = StartButton(settings_.debounce_ns, settings_.stuck_after_ns);
  return {};
}

void Panel::close_lines() noexcept {
  for (std::size_t i = 0; i < kLineRoles; ++i) {
    if (lines_[i]) states_[i] = LineState::Lost;
    lines_[i].reset();
  }
}

Result<void> Panel::start() {
  thread_ = std::thread([this] { read_forever(); });
  pthread_setname_np(thread_.native_handle(), "clampd-panel");
  return make_realtime(thread_, settings_.loop_priority - 1);
}

void Panel::show(const Outlook& outlook) noexcept {
  concluding_ = outlook.concluding;
  clamped_ = outlook.clamped;
  last_verdict_ = outlook.last ? static_cast<int>(*outlook.last) : -1;
}

void Panel::read_forever() {
  std::int64_t tried_ns = 0;
  bool open = true;
  while (!stop_) {
    wait_for_edges();
    const std::int64_t now_ns = monotonic_now_ns();
    if (!open && now_ns - tried_ns > kReopenEvery_ns) {
      tried_ns = now_ns;
      open = open_lines().has_value();
    }
    open = open && read_levels(now_ns) && drive_lights(now_ns);
    if (!open) close_lines();
    const bool guarded = guard_works(now_ns);
    publish(!open || !guarded, now_ns);
  }
}

void Panel::wait_for_edges() noexcept {
  std::array<pollfd, kInputRoles> files{};
  for (std::size_t i = 0; i < kInputRoles; ++i)
    files[i] = {lines_[i] ? lines_[i]->file() : -1, POLLIN, 0};  // poll() skips negative ones
  timespec patience{};
  patience.tv_nsec = static_cast<long>(settings_.poll_ns);
  if (ppoll(files.data(), files.size(), &patience, nullptr) <= 0) return;
  for (std::size_t i = 0; i < kInputRoles; ++i) {
    for (int edges = 0; (files[i].revents & POLLIN) != 0 && edges < kEdgesPerRound; ++edges) {
      const std::optional<Edge> edge = lines_[i]->read_edge();
      if (!edge) break;  // the level says what is wrong
      take(static_cast<LineRole>(i), *edge);
      poll(&files[i], 1, 0);
    }
  }
}

void Panel::take(LineRole role, const Edge& edge) noexcept {
  switch (role) {
    case LineRole::EmergencyStop:
      // An edge that ends closed has opened before, be it too short for the kernel to see it open.
      emergency_stop_.feed(false, edge.stamp_ns);
      emergency_stop_.feed(edge.closed, edge.stamp_ns);
      if (!edge.closed) emergency_stop_opened_ns_ = edge.stamp_ns;
      break;
    case LineRole::FixtureClosed:
      fixture_.feed(edge.closed, edge.stamp_ns);
      break;
    case LineRole::StartButton:
      start_button_.feed(edge.closed, edge.stamp_ns);
      break;
    default:
      break;
  }
}

bool Panel::read_levels(std::int64_t now_ns) noexcept {
  for (std::size_t i = 0; i < kInputRoles; ++i) {
    if (!lines_[i]) continue;
    const auto role = static_cast<LineRole>(i);
    const std::optional<bool> closed = lines_[i]->level();
    if (!closed) return lose(role, errno);
    states_[i] = *closed ? LineState::On : LineState::Off;
    // The level also makes up for an edge that got lost.
    if (role == LineRole::EmergencyStop) emergency_stop_.feed(*closed, now_ns);
    if (role == LineRole::FixtureClosed) fixture_.feed(*closed, now_ns);
    if (role == LineRole::StartButton) start_button_.feed(*closed, now_ns);
  }
  return true;
}

bool Panel::drive_lights(std::int64_t now_ns) noexcept {
  const int verdict = last_verdict_;
  const std::optional<Verdict> last =
      verdict < 0 ? std::nullopt : std::optional(static_cast<Verdict>(verdict));
  const StackLight light = stack_light(sign_of(board().last_beat().state, {concluding_, last, clamped_}));
  const std::array lamps{light.red, light.amber, light.green};
  for (std::size_t k = 0; k < kLights.size(); ++k) {
    const std::size_t i = index(kLights[k]);
    if (!lines_[i]) continue;
    const bool on = is_lit(lamps[k], now_ns);
    const bool set = on == lit_[k] || lines_[i]->set(on);
    if (!set || !lines_[i]->level()) return lose(kLights[k], errno);
    lit_[k] = on;
    states_[i] = on ? LineState::On : LineState::Off;
  }
  return true;
}

bool Panel::guard_works(std::int64_t now_ns) {
  if (!guard_) return true;
  if (now_ns - memory_->guard_beat_ns > kGuardSilent_ns) {
    drop_relay_of_ended_guard();
    return lose(LineRole::EnableRelay, 0);
  }
  const RelayState relay = memory_->relay;
  if (relay == RelayState::Lost) return lose(LineRole::EnableRelay, memory_->relay_error);
  states_[index(LineRole::EnableRelay)] = relay == RelayState::On ? LineState::On : LineState::Off;
  return true;
}

void Panel::drop_relay_of_ended_guard() {
  std::optional<Line>& relay = lines_[index(LineRole::EnableRelay)];
  if (relay || !guard_->ended()) return;
  if (Result<Line> line =
          Line::open_output(settings_.line(LineRole::EnableRelay), LineRole::EnableRelay, false))
    relay.emplace(std::move(*line));
}

void Panel::publish(bool lost, std::int64_t now_ns) noexcept {
  Interlocks interlocks;
  interlocks.lost = lost;
  if (!lost) {
    interlocks.emergency_stop = !emergency_stop_.closed(now_ns);
    interlocks.fixture_open = has(LineRole::FixtureClosed) && !fixture_.closed(now_ns);
    if (has(LineRole::StartButton)) {
      if (const std::optional<std::int64_t> pressed_ns = start_button_.pressed(now_ns))
        start_press_.note(*pressed_ns);
      interlocks.start_button_stuck = start_button_.stuck();
    }
  }
  if (interlocks.lost || interlocks.emergency_stop || interlocks.fixture_open) start_press_.block();
  const bool was_silent = published_ns_ > 0 && now_ns - published_ns_ > settings_.lost_after_ns;
  if (was_silent && !lost) trouble_ = 0;  // the loop has seen that, and no line is to blame
  published_ns_ = now_ns;
  lost_before_ = lost;
  board().publish(interlocks, now_ns);
}

bool Panel::lose(LineRole role, int error) noexcept {
  states_[index(role)] = LineState::Lost;
  if (!lost_before_)  // what was lost first is what to look at; the rest often follows from it
    trouble_ = static_cast<std::uint32_t>(index(role)) + 1 + (static_cast<std::uint32_t>(error) << 8);
  return false;
}

std::string Panel::explain(FaultCause cause) const {
  switch (cause) {
    case FaultCause::EmergencyStop:
      return fmt::format("{} opened: pressed, or its wire is off.", name(LineRole::EmergencyStop));
    case FaultCause::FixtureOpen:
      return fmt::format("{} opened.", name(LineRole::FixtureClosed));
    case FaultCause::StartButtonStuck:
      return fmt::format("{} stays closed.", name(LineRole::StartButton));
    case FaultCause::InterlockLost: {
      const std::uint32_t trouble = trouble_;
      if (trouble == 0)
        return fmt::format("The panel's reader was silent for more than {} ms.",
                           settings_.lost_after_ns / kNanosecondsPerMillisecond);
      const auto role = static_cast<LineRole>((trouble & 0xff) - 1);
      const int error = static_cast<int>(trouble >> 8);
      return fmt::format("{}: {}.", name(role),
                         error == 0 ? "its guard ended or stands still" : std::strerror(error));
    }
    default:
      return "";
  }
}

std::vector<LineReport> Panel::report() const {
  std::vector<LineReport> lines;
  for (std::size_t i = 0; i < kLineRoles; ++i) {
    const auto role = static_cast<LineRole>(i);
    if (!has(role)) continue;
    const LineState state = states_[i];
    const char* shown = state == LineState::Lost ? "lost"
                        : is_input(role)         ? (state == LineState::On ? "closed" : "open")
                                                 : (state == LineState::On ? "on" : "off");
    lines.push_back({name(role), std::string(to_string(role)), shown});
  }
  return lines;
}

}  // namespace clampd::gpio
