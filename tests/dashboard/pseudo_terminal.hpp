#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

namespace clampd::screen {

/// A program in a terminal of its own, with what it has written there.
class PseudoTerminal {
 public:
  /// `arguments` begin with the program; `environment`: "NAME=VALUE" to add.
  PseudoTerminal(const std::vector<std::string>& arguments, int columns,
                 const std::vector<std::string>& environment = {});
  ~PseudoTerminal();
  PseudoTerminal(const PseudoTerminal&) = delete;
  PseudoTerminal& operator=(const PseudoTerminal&) = delete;

  /// Reads until this was written; false if the program ended first.
  bool writes(const std::string& text);
  /// What Ctrl-C does.
  void interrupt() const;
  /// Reads to its end, and gives its exit code (-signal if it was killed).
  int end();
  const std::string& output() const { return output_; }

 private:
  bool read_some();

  int master_ = -1;
  pid_t pid_ = -1;
  std::string output_;
};

}  // namespace clampd::screen
