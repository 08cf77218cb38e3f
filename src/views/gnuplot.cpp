#include "src/views/gnuplot.hpp"

#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include <fmt/format.h>

namespace clampd::report {
namespace {

/// A file in memory. Files rather than pipes: no side ever waits for the other.
class MemoryFile {
 public:
  explicit MemoryFile(const char* name) : descriptor_(memfd_create(name, MFD_CLOEXEC)) {}
  ~MemoryFile() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;

  int descriptor() const { return descriptor_; }

  bool write(std::string_view text) {
    while (!text.empty()) {
      const ssize_t count = ::write(descriptor_, text.data(), text.size());
      if (count < 0) return false;
      text.remove_prefix(static_cast<std::size_t>(count));
    }
    return ::lseek(descriptor_, 0, SEEK_SET) == 0;
  }

  std::string read() {
    std::string text;
    char buffer[65536];
    ::lseek(descriptor_, 0, SEEK_SET);
    for (ssize_t count = 0; (count = ::read(descriptor_, buffer, sizeof buffer)) > 0;)
      text.append(buffer, static_cast<std::size_t>(count));
    return text;
  }

 private:
  int descriptor_;
};

/// An errno of posix_spawnp, or 0.
int spawn_gnuplot(pid_t& child, const MemoryFile& script, const MemoryFile& output,
                  const MemoryFile& complaints) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, script.descriptor(), STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, output.descriptor(), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, complaints.descriptor(), STDERR_FILENO);
  char program[] = "gnuplot";
  char without_settings[] = "-d";
  char* const arguments[] = {program, without_settings, nullptr};
  const int error = posix_spawnp(&child, program, &actions, nullptr, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  return error;
}

}  // namespace

Result<std::string> run_gnuplot(std::string_view script) {
  MemoryFile input("gnuplot-script"), output("gnuplot-output"), complaints("gnuplot-complaints");
  if (!input.write(script) || output.descriptor() < 0 || complaints.descriptor() < 0)
    return failure(fmt::format("cannot pass a figure to gnuplot: {}", std::strerror(errno)));
  pid_t child = 0;
  if (const int error = spawn_gnuplot(child, input, output, complaints); error != 0) {
    if (error == ENOENT)
      return failure(
          "figures are drawn by gnuplot, which is not installed (or not in PATH); on Debian: "
          "apt-get install gnuplot-nox");
    return failure(fmt::format("cannot start gnuplot: {}", std::strerror(error)));
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
    return failure(fmt::format("gnuplot could not draw a figure: {}", complaints.read()));
  return output.read();
}

}  // namespace clampd::report
