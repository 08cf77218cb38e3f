#include "drivers/gpio/lines.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <utility>

#include <fmt/format.h>
#include <gpiod.h>

#include "clampd/base/clock.hpp"

namespace clampd::gpio {

namespace {

constexpr const char* kConsumer = "clampd";

std::optional<unsigned> offset_of(const std::string& line) {
  unsigned offset = 0;
  const auto parsed = std::from_chars(line.data(), line.data() + line.size(), offset);
  if (parsed.ec != std::errc() || parsed.ptr != line.data() + line.size()) return std::nullopt;
  return offset;
}

std::string advice_for(int error, const gpiod_line* line) {
  const char* consumer = line == nullptr ? nullptr : gpiod_line_consumer(const_cast<gpiod_line*>(line));
  switch (error) {
    case EBUSY:
      return fmt::format("it is in use by '{}'; end that program or name another line in [gpio]",
                         consumer == nullptr ? "another program" : consumer);
    case EACCES:
    case EPERM:
      return "no right to the chip: let the station's user read and write /dev/gpiochip* (group gpio)";
    case ENOENT:
    case ENODEV:
      return "there is no such chip or line; `clampctl doctor` and `gpioinfo` tell which there are";
    case ENXIO:
    case EOPNOTSUPP:
      return "the line cannot do that: inputs need a chip that interrupts on edges, biases one that has them";
    default:
      return "look at the chip's wiring and at the kernel's log";
  }
}

tl::unexpected<Error> line_error(const LineSettings& settings, LineRole role, int error,
                                 const gpiod_line* line = nullptr) {
  return failure(
      fmt::format("{}: {}; {}", describe(settings, role), std::strerror(error), advice_for(error, line)));
}

gpiod_chip* open_chip(const LineSettings& settings) {
  errno = 0;
  if (!settings.chip.empty()) return gpiod_chip_open_lookup(settings.chip.c_str());
  gpiod_line* line = gpiod_line_find(settings.line.c_str());
  return line == nullptr ? nullptr : gpiod_line_get_chip(line);
}

gpiod_line* find_line(gpiod_chip* chip, const std::string& name) {
  errno = 0;
  const std::optional<unsigned> offset = offset_of(name);
  if (!offset) return gpiod_chip_find_line(chip, name.c_str());
  if (*offset >= gpiod_chip_num_lines(chip)) {
    errno = ENOENT;
    return nullptr;
  }
  return gpiod_chip_get_line(chip, *offset);
}

int request_flags(const LineSettings& settings) {
  int flags = settings.active_low ? GPIOD_LINE_REQUEST_FLAG_ACTIVE_LOW : 0;
  switch (settings.bias) {
    case Bias::AsIs:
      return flags;
    case Bias::Disabled:
      return flags | GPIOD_LINE_REQUEST_FLAG_BIAS_DISABLE;
    case Bias::PullUp:
      return flags | GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_UP;
    case Bias::PullDown:
      return flags | GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_DOWN;
  }
  return flags;
}

}  // namespace

std::string describe(const LineSettings& settings, LineRole role) {
  if (settings.chip.empty()) return fmt::format("line {} ({})", settings.line, to_string(role));
  return fmt::format("{} line {} ({})", settings.chip, settings.line, to_string(role));
}

void Line::CloseChip::operator()(gpiod_chip* chip) const noexcept {
  gpiod_chip_close(chip);
}

Result<Line> Line::find(const LineSettings& settings, LineRole role) {
  Line found;
  found.chip_.reset(open_chip(settings));
  if (found.chip_) found.line_ = find_line(found.chip_.get(), settings.line);
  if (found.line_ == nullptr) return line_error(settings, role, errno == 0 ? ENOENT : errno);
  return found;
}

Result<Line> Line::open_input(const LineSettings& settings, LineRole role) {
  Result<Line> input = find(settings, role);
  if (input &&
      gpiod_line_request_both_edges_events_flags(input->line_, kConsumer, request_flags(settings)) != 0)
    return line_error(settings, role, errno, input->line_);
  return input;
}

Result<Line> Line::open_output(const LineSettings& settings, LineRole role, bool on) {
  Result<Line> output = find(settings, role);
  if (output &&
      gpiod_line_request_output_flags(output->line_, kConsumer, request_flags(settings), on ? 1 : 0) != 0)
    return line_error(settings, role, errno, output->line_);
  return output;
}

int Line::file() const noexcept {
  return gpiod_line_event_get_fd(line_);
}

std::optional<Edge> Line::read_edge() noexcept {
  gpiod_line_event event{};
  if (gpiod_line_event_read(line_, &event) != 0) return std::nullopt;
  return Edge{event.event_type == GPIOD_LINE_EVENT_RISING_EDGE,
              static_cast<std::int64_t>(event.ts.tv_sec) * kNanosecondsPerSecond + event.ts.tv_nsec};
}

std::optional<bool> Line::level() noexcept {
  const int value = gpiod_line_get_value(line_);
  if (value < 0) return std::nullopt;
  return value != 0;
}

bool Line::set(bool on) noexcept {
  return gpiod_line_set_value(line_, on ? 1 : 0) == 0;
}

Result<LineInfo> inspect_line(const LineSettings& settings, LineRole role) {
  const Result<Line> found = Line::find(settings, role);
  if (!found) return tl::unexpected(found.error());
  gpiod_chip* const chip = found->chip_.get();
  gpiod_line* const line = found->line_;
  LineInfo info;
  info.chip = fmt::format("{} [{}]", gpiod_chip_name(chip), gpiod_chip_label(chip));
  info.offset = gpiod_line_offset(line);
  if (const char* name = gpiod_line_name(line)) info.name = name;
  if (gpiod_line_is_used(line)) {
    const char* consumer = gpiod_line_consumer(line);
    info.consumer = consumer == nullptr ? "the kernel" : consumer;
  }
  return info;
}

}  // namespace clampd::gpio
