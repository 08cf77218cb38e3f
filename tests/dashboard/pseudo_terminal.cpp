#include "dashboard/pseudo_terminal.hpp"

#include <pty.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>

namespace clampd::screen {

PseudoTerminal::PseudoTerminal(const std::vector<std::string>& arguments, int columns,
                               const std::vector<std::string>& environment) {
  std::vector<char*> pointers;
  for (const std::string& argument : arguments) pointers.push_back(const_cast<char*>(argument.c_str()));
  pointers.push_back(nullptr);
  const winsize size{
      .ws_row = 24, .ws_col = static_cast<unsigned short>(columns), .ws_xpixel = 0, .ws_ypixel = 0};
  pid_ = forkpty(&master_, nullptr, nullptr, &size);
  if (pid_ != 0) return;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  unsetenv("COLUMNS");
  unsetenv("NO_COLOR");
  for (const std::string& variable : environment) putenv(const_cast<char*>(variable.c_str()));
  execvp(pointers[0], pointers.data());
  _exit(127);
}

PseudoTerminal::~PseudoTerminal() {
  if (pid_ > 0) {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
  if (master_ >= 0) close(master_);
}

/// False at the end: reading from a terminal that nobody holds any more is an error.
bool PseudoTerminal::read_some() {
  std::array<char, 4096> buffer{};
  const ssize_t count = read(master_, buffer.data(), buffer.size());
  if (count <= 0) return false;
  output_.append(buffer.data(), static_cast<std::size_t>(count));
  return true;
}

bool PseudoTerminal::writes(const std::string& text) {
  while (output_.find(text) == std::string::npos)
    if (!read_some()) return false;
  return true;
}

void PseudoTerminal::interrupt() const {
  const char key = 3;
  if (write(master_, &key, 1) != 1) kill(pid_, SIGINT);
}

int PseudoTerminal::end() {
  while (read_some()) {
  }
  int status = 0;
  waitpid(pid_, &status, 0);
  pid_ = -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

}  // namespace clampd::screen
