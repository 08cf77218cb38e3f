#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/ports/interlocks.hpp"
#include "clampd/record/check_record.hpp"
#include "drivers/gpio/lines.hpp"
#include "drivers/gpio/panel_logic.hpp"
#include "drivers/gpio/relay_guard.hpp"

namespace clampd::gpio {

struct PanelSettings {
  std::array<LineSettings, kLineRoles> lines;  ///< by LineRole; the emergency stop must be used
  std::int64_t debounce_ns = 0;                ///< of start button and fixture
  std::int64_t release_ns = 0;      ///< how long the emergency stop must stay closed to be released
  std::int64_t stuck_after_ns = 0;  ///< a start button held for longer is stuck
  std::int64_t poll_ns = 0;         ///< the levels are read at least so often, edges or not
  std::int64_t lost_after_ns = 0;   ///< a reader silent for longer is lost to the loop
  std::int64_t relay_watchdog_ns = 0;
  int loop_priority = 0;  ///< of the loop; 0: everything runs as ordinary threads

  const LineSettings& line(LineRole role) const { return lines[static_cast<std::size_t>(role)]; }
};

/// A line as it stands now, for people.
struct LineReport {
  std::string line;  ///< as describe()
  std::string role;
  std::string state;  ///< "closed", "open", "on", "off" or "lost"
};

/// The operator's panel: reads the inputs on a thread of its own and publishes them to the loop's board,
/// drives the lights, keeps the relay's guard. The thread runs one priority below the loop, so that a
/// chattering contact cannot take the processor from the tick.
class Panel {
 public:
  /// Opens every line and starts the relay's guard: call it before there are any threads. Errors name the
  /// line and what to do.
  static Result<std::unique_ptr<Panel>> open(const PanelSettings& settings);
  /// Lights off, relay off.
  ~Panel();
  Panel(const Panel&) = delete;
  Panel& operator=(const Panel&) = delete;

  /// For the loop; lives as long as this.
  InterlockBoard& board() noexcept { return memory_->board; }

  /// Starts to read. Error: no right to real time.
  Result<void> start();

  /// Each press of the start button once, with its edge's stamp (CLOCK_MONOTONIC), unless it is too old by
  /// now.
  std::optional<StartPress::Press> take_start_press(std::int64_t now_ns) noexcept {
    return start_press_.take(now_ns);
  }
  /// For the lights.
  void show(const Outlook& outlook) noexcept;

  bool has(LineRole role) const noexcept { return settings_.line(role).used(); }
  std::string name(LineRole role) const { return describe(settings_.line(role), role); }
  /// When the kernel saw the emergency stop open, CLOCK_MONOTONIC; 0: never.
  std::int64_t emergency_stop_opened_ns() const noexcept { return emergency_stop_opened_ns_; }
  /// Which line is behind a fault of the panel, and what it shows; empty for other causes.
  std::string explain(FaultCause cause) const;
  /// Every line that the station has.
  std::vector<LineReport> report() const;

 private:
  enum class LineState : std::uint8_t { Lost, Off, On };

  Panel(const PanelSettings& settings, SharedMemory memory);
  Result<void> open_lines();
  void close_lines() noexcept;
  void read_forever();
  void wait_for_edges() noexcept;
  void take(LineRole role, const Edge& edge) noexcept;
  bool read_levels(std::int64_t now_ns) noexcept;  ///< false: a line is lost, as the next two
  bool drive_lights(std::int64_t now_ns) noexcept;
  bool guard_works(std::int64_t now_ns);
  void drop_relay_of_ended_guard();
  void publish(bool lost, std::int64_t now_ns) noexcept;
  bool lose(LineRole role, int error) noexcept;  ///< false, for its callers

  const PanelSettings settings_;
  SharedMemory memory_;
  std::unique_ptr<RelayGuard> guard_;
  std::array<std::optional<Line>, kLineRoles> lines_;
  std::array<bool, 3> lit_{};
  Contact emergency_stop_;
  Contact fixture_;
  StartButton start_button_;

  std::int64_t published_ns_ = 0;
  bool lost_before_ = false;

  std::thread thread_;
  std::atomic<bool> stop_{false};
  StartPress start_press_;
  std::atomic<bool> concluding_{false};
  std::atomic<bool> clamped_{false};
  std::atomic<int> last_verdict_{-1};
  std::array<std::atomic<LineState>, kLineRoles> states_{};
  std::atomic<std::uint32_t> trouble_{
      0};  ///< the latest to be lost first: role + 1, errno << 8; 0 errno: the guard
  std::atomic<std::int64_t> emergency_stop_opened_ns_{0};
};

}  // namespace clampd::gpio
