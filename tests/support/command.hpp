#pragma once

#include <sys/wait.h>

#include <cstdio>
#include <stdexcept>
#include <string>

namespace clampd::support {

/// How a command ended.
struct Outcome {
  int exit_code = -1;  ///< -signal if it was killed
  std::string output;  ///< stdout and stderr, as in a terminal
};

/// Runs a line of shell to its end. Throws where there is no shell.
inline Outcome run_command(const std::string& line) {
  FILE* const pipe = ::popen(("{ " + line + "\n} 2>&1").c_str(), "r");
  if (pipe == nullptr) throw std::runtime_error("no shell for: " + line);
  Outcome outcome;
  char buffer[4096];
  while (const std::size_t count = std::fread(buffer, 1, sizeof buffer, pipe))
    outcome.output.append(buffer, count);
  const int status = ::pclose(pipe);
  outcome.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  return outcome;
}

}  // namespace clampd::support
