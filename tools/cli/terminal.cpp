#include "tools/cli/terminal.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include <fmt/format.h>

namespace clampd::cli {

namespace {

bool no_colour_requested() {
  const char* no_color = std::getenv("NO_COLOR");
  return no_color != nullptr && *no_color != '\0';
}

}  // namespace

bool colours_wanted() {
  return isatty(STDOUT_FILENO) == 1 && !no_colour_requested();
}

void print_error(std::string_view message) {
  const bool colour = isatty(STDERR_FILENO) == 1 && !no_colour_requested();
  fmt::print(stderr, "{}error:{} {}\n", colour ? "\033[1;31m" : "", colour ? "\033[0m" : "", message);
}

void print_notice(std::string_view message) {
  fmt::print(stderr, "note: {}\n", message);
}

ProgressLine::ProgressLine() : terminal_(isatty(STDERR_FILENO) == 1) {}

void ProgressLine::show(double fraction, std::string_view text) {
  if (!terminal_) return;
  constexpr int kWidth = 30;
  const int filled = std::clamp(static_cast<int>(fraction * kWidth), 0, kWidth);
  std::string bar;
  for (int i = 0; i < kWidth; ++i) bar += i < filled ? "█" : "░";
  std::string line = fmt::format("{} {:3.0f} %  {}", bar, 100.0 * std::clamp(fraction, 0.0, 1.0), text);
  if (line == shown_) return;
  fmt::print(stderr, "\r\033[K{}", line);
  std::fflush(stderr);
  shown_ = std::move(line);
}

void ProgressLine::clear() {
  if (shown_.empty()) return;
  fmt::print(stderr, "\r\033[K");
  std::fflush(stderr);
  shown_.clear();
}

}  // namespace clampd::cli
