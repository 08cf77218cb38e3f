#pragma once

#include <string>
#include <string_view>

namespace clampd::cli {

/// True where stdout is a terminal and NO_COLOR is not set.
bool colours_wanted();

/// "error: ..." on stderr.
void print_error(std::string_view message);

/// "note: ..." on stderr.
void print_notice(std::string_view message);

/// One line of progress that overwrites itself; silent where stderr is not a terminal.
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
  bool terminal_ = false;
  std::string shown_;
};

}  // namespace clampd::cli
