#include "tools/cli/terminal.hpp"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include <fmt/format.h>

namespace clampd::cli {

namespace {

std::string_view environment(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? std::string_view() : value;
}

/// A terminal that knows what escape sequences mean.
bool is_capable(int file) {
  const std::string_view kind = environment("TERM");
  return isatty(file) == 1 && !kind.empty() && kind != "dumb";
}

bool takes_colours(int file) {
  return is_capable(file) && environment("NO_COLOR").empty();
}

/// What the terminal says and what COLUMNS says: the smaller, since a line too short does no harm.
int columns_of_terminal() {
  constexpr int kUsual = 80;
  winsize size{};
  const int told = ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 ? size.ws_col : 0;
  const int wanted = std::atoi(std::string(environment("COLUMNS")).c_str());
  if (told <= 0 && wanted <= 0) return kUsual;
  return told <= 0 ? wanted : wanted <= 0 ? told : std::min(told, wanted);
}

bool begins_character(char byte) {
  return (static_cast<unsigned char>(byte) & 0xC0U) != 0x80U;
}

int width_of(std::string_view text) {
  return static_cast<int>(std::count_if(text.begin(), text.end(), begins_character));
}

std::string_view first_columns(std::string_view text, int columns) {
  std::size_t end = 0;
  for (int used = 0; end < text.size(); ++end)
    if (begins_character(text[end]) && ++used > columns) break;
  return text.substr(0, end);
}

}  // namespace

bool colours_wanted() {
  return takes_colours(STDOUT_FILENO);
}

void print_error(std::string_view message) {
  const bool colour = takes_colours(STDERR_FILENO);
  fmt::print(stderr, "{}error:{} {}\n", colour ? "\033[1;31m" : "", colour ? "\033[0m" : "", message);
}

void print_notice(std::string_view message) {
  fmt::print(stderr, "note: {}\n", message);
}

std::string progress_text(double fraction, std::string_view text, std::chrono::seconds elapsed, int columns) {
  constexpr int kWidest = 30, kNarrowest = 8;
  const double done = std::clamp(fraction, 0.0, 1.0);
  std::string line = fmt::format("{:3.0f} %  {}", 100.0 * done, text);
  if (elapsed.count() > 0) line += fmt::format(", {} s", elapsed.count());
  const int room = std::max(0, columns - 1);
  const int width = std::min(kWidest, room - width_of(line) - 1);
  if (width < kNarrowest) return std::string(first_columns(line, room));
  std::string bar;
  for (int i = 0; i < width; ++i) bar += i < static_cast<int>(done * width) ? "█" : "░";
  return bar + " " + line;
}

ProgressLine::ProgressLine() : terminal_(is_capable(STDERR_FILENO)) {
  if (terminal_) clock_ = std::jthread([this](const std::stop_token& stopping) { tell_the_time(stopping); });
}

void ProgressLine::tell_the_time(const std::stop_token& stopping) {
  std::unique_lock lock(mutex_);
  while (!stopping.stop_requested()) {
    if (active_) draw();
    passing_.wait_for(lock, stopping, std::chrono::seconds(1), [] { return false; });
  }
}

void ProgressLine::draw() {
  const auto elapsed = std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - began_);
  std::string line = progress_text(fraction_, text_, elapsed, columns_of_terminal());
  if (line == shown_) return;
  fmt::print(stderr, "\r\033[K{}", line);
  std::fflush(stderr);
  shown_ = std::move(line);
}

void ProgressLine::show(double fraction, std::string_view text) {
  if (!terminal_) return;
  const std::lock_guard lock(mutex_);
  if (!active_) began_ = Clock::now();
  active_ = true;
  fraction_ = fraction;
  text_ = text;
  draw();
}

void ProgressLine::clear() {
  const std::lock_guard lock(mutex_);
  active_ = false;
  if (shown_.empty()) return;
  fmt::print(stderr, "\r\033[K");
  std::fflush(stderr);
  shown_.clear();
}

}  // namespace clampd::cli
