#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>

namespace clampd::cli {

/// True where stdout is a terminal that knows colours (TERM is not "dumb") and NO_COLOR is not set.
bool colours_wanted();

/// "error: ..." on stderr.
void print_error(std::string_view message);

/// "note: ..." on stderr.
void print_notice(std::string_view message);

/// Progress as it fits into a terminal of so many columns, the last of which stays free: the bar gives way to
/// the words, and they are cut where nothing else helps. `fraction` in 0..1; the time is told from one second
/// on.
std::string progress_text(double fraction, std::string_view text, std::chrono::seconds elapsed, int columns);

/// One line of progress that overwrites itself, and goes on to tell the time while nobody calls; silent where
/// stderr is no terminal, or one that cannot overwrite a line.
class ProgressLine {
 public:
  ProgressLine();
  ~ProgressLine() { clear(); }
  ProgressLine(const ProgressLine&) = delete;
  ProgressLine& operator=(const ProgressLine&) = delete;

  /// `fraction` in 0..1.
  void show(double fraction, std::string_view text);
  void clear();

 private:
  using Clock = std::chrono::steady_clock;
  void tell_the_time(const std::stop_token& stopping);
  void draw();

  const bool terminal_;
  std::mutex mutex_;  ///< guards all below but the thread
  bool active_ = false;
  Clock::time_point began_;
  double fraction_ = 0.0;
  std::string text_;
  std::string shown_;
  std::condition_variable_any passing_;  ///< never told of anything: only to wait until the end
  std::jthread clock_;                   ///< last: it uses all of the above
};

}  // namespace clampd::cli
