#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

namespace clampd::screen {

/// A program beside the test, ended with it whatever happens.
class Program {
 public:
  /// `arguments` begin with the program; its output goes to `log`. `environment`: "NAME=VALUE" to add.
  Program(const std::vector<std::string>& arguments, const std::string& log,
          const std::vector<std::string>& environment = {});
  ~Program() { end(); }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  pid_t process() const { return pid_; }
  void send(int signal) const;
  /// Asks it to end, waits, and gives its exit code (-signal if it was killed).
  int end();
  /// Waits for its own end.
  int wait();

 private:
  pid_t pid_ = -1;
  int exit_code_ = 0;
};

}  // namespace clampd::screen
