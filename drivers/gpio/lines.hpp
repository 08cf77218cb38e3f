#pragma once

// Lines of GPIO chips. lines.cpp is the one file that knows libgpiod.

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "drivers/gpio/panel_logic.hpp"

struct gpiod_chip;
struct gpiod_line;

namespace clampd::gpio {

enum class Bias : std::uint8_t { AsIs, Disabled, PullUp, PullDown };

/// Where a line is and what its level means.
struct LineSettings {
  std::string chip;  ///< name, number, path or label; empty: the line is looked for by name on all chips
  std::string line;  ///< offset or name; empty: the station has no such line
  bool active_low = false;  ///< the contact is closed, the output on, at the low level
  Bias bias = Bias::AsIs;

  bool used() const { return !line.empty(); }
};

/// How messages name a line: "gpiochip0 line 4 (emergency stop)".
std::string describe(const LineSettings& settings, LineRole role);

/// A change of a contact with the kernel's CLOCK_MONOTONIC stamp of it.
struct Edge {
  bool closed = false;
  std::int64_t stamp_ns = 0;
};

/// A line as it is found without requesting it.
struct LineInfo {
  std::string chip;  ///< "gpiochip0 [label]"
  std::uint32_t offset = 0;
  std::string name;
  std::string consumer;  ///< who has it; empty: nobody
};

/// One requested line. It is given back when this goes; its level then is up to the chip.
class Line {
 public:
  /// An input that reports both edges. Errors name the line: no such chip or line, no right to it, in use by
  /// whom, no interrupt.
  static Result<Line> open_input(const LineSettings& settings, LineRole role);
  static Result<Line> open_output(const LineSettings& settings, LineRole role, bool on);
  friend Result<LineInfo> inspect_line(const LineSettings& settings, LineRole role);

  /// Of an input: readable by poll(2) when an edge waits.
  int file() const noexcept;
  /// The oldest edge that waits; call it only then. Nothing if it cannot be read, with errno set.
  std::optional<Edge> read_edge() noexcept;
  /// Closed or on; nothing if the line cannot be read, with errno set.
  std::optional<bool> level() noexcept;
  /// False if the line cannot be driven, with errno set.
  bool set(bool on) noexcept;

 private:
  struct CloseChip {
    void operator()(gpiod_chip* chip) const noexcept;
  };

  /// Not requested yet.
  static Result<Line> find(const LineSettings& settings, LineRole role);

  std::unique_ptr<gpiod_chip, CloseChip> chip_;
  gpiod_line* line_ = nullptr;  ///< belongs to the chip
};

/// Errors: no such chip or line.
Result<LineInfo> inspect_line(const LineSettings& settings, LineRole role);

}  // namespace clampd::gpio
