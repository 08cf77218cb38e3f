#include "clampd/record/file.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <thread>

#include <fmt/format.h>

namespace clampd {
namespace {

constexpr std::size_t kMaxFile_bytes = std::size_t{256} << 20;

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;

  int get() const { return fd_; }
  bool valid() const { return fd_ >= 0; }

  /// Closes now; false if the kernel reports a write error only here (network file systems do).
  bool close() {
    const int fd = fd_;
    fd_ = -1;
    return ::close(fd) == 0;
  }

 private:
  int fd_;
};

bool write_all(int fd, std::string_view content) {
  while (!content.empty()) {
    const ssize_t written = ::write(fd, content.data(), content.size());
    if (written < 0) {
      if (errno == EINTR) continue;
      return false;
    }
    content.remove_prefix(static_cast<std::size_t>(written));
  }
  return true;
}

std::string reason(int error) {
  return std::generic_category().message(error);
}

tl::unexpected<Error> cannot_write(const std::string& path, int error) {
  return failure(fmt::format("{}: cannot write: {}", path, reason(error)));
}

mode_t new_file_mode() {
  const mode_t mask = ::umask(0);
  ::umask(mask);
  return static_cast<mode_t>(0666 & ~mask);
}

}  // namespace

Result<std::string> read_file(const std::string& path) {
  // O_NONBLOCK: opening a named pipe by mistake must not hang before it can be refused.
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!file.valid()) return failure(fmt::format("{}: cannot open: {}", path, reason(errno)));
  struct stat status {};
  if (::fstat(file.get(), &status) != 0)
    return failure(fmt::format("{}: cannot read: {}", path, reason(errno)));
  if (S_ISDIR(status.st_mode)) return failure(fmt::format("{}: is a directory, not a file", path));
  if (!S_ISREG(status.st_mode)) return failure(fmt::format("{}: is not a regular file", path));
  if (static_cast<std::size_t>(status.st_size) > kMaxFile_bytes)
    return failure(fmt::format("{}: has {} MiB; files of more than {} MiB are refused", path,
                               status.st_size >> 20, kMaxFile_bytes >> 20));
  std::string content(static_cast<std::size_t>(status.st_size), '\0');
  std::size_t filled = 0;
  while (filled < content.size()) {
    const ssize_t got = ::read(file.get(), content.data() + filled, content.size() - filled);
    if (got < 0) {
      if (errno == EINTR) continue;
      return failure(fmt::format("{}: cannot read: {}", path, reason(errno)));
    }
    if (got == 0) break;
    filled += static_cast<std::size_t>(got);
  }
  content.resize(filled);
  return content;
}

Result<void> write_file_atomically(const std::string& path, std::string_view content) {
  namespace fs = std::filesystem;
  if (path.empty()) return failure("cannot write a file with an empty name");

  struct stat existing {};
  std::string target = path;
  if (::stat(path.c_str(), &existing) == 0) {
    if (S_ISDIR(existing.st_mode)) return failure(fmt::format("{}: cannot write: is a directory", path));
    if (!S_ISREG(existing.st_mode)) {
      // A pipe or device (/dev/stdout) takes the bytes; renaming over it would replace the device itself.
      Descriptor stream(::open(path.c_str(), O_WRONLY | O_CLOEXEC));
      if (!stream.valid() || !write_all(stream.get(), content)) return cannot_write(path, errno);
      return {};
    }
    std::error_code error;
    const fs::path resolved = fs::canonical(path, error);  // through a link: replace the file, keep the link
    if (!error) target = resolved.string();
  }

  const fs::path target_path(target);
  const fs::path directory = target_path.has_parent_path() ? target_path.parent_path() : fs::path(".");
  std::string temporary = (directory / fmt::format(".{}.XXXXXX", target_path.filename().string())).string();
  Descriptor file(::mkostemp(temporary.data(), O_CLOEXEC));
  if (!file.valid()) return cannot_write(path, errno);

  const auto give_up = [&](int error) -> Result<void> {
    ::unlink(temporary.c_str());
    return cannot_write(path, error);
  };
  if (!write_all(file.get(), content)) return give_up(errno);
  if (::fchmod(file.get(), existing.st_nlink > 0 ? existing.st_mode & 07777 : new_file_mode()) != 0)
    return give_up(errno);
  if (::fsync(file.get()) != 0) return give_up(errno);
  if (!file.close()) return give_up(errno);
  if (::rename(temporary.c_str(), target.c_str()) != 0) return give_up(errno);

  // The name is durable only once the directory is; a file system that cannot sync directories is left at
  // that.
  const Descriptor folder(::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (folder.valid()) ::fsync(folder.get());
  return {};
}

Result<FileLock> FileLock::take(const std::string& path, std::chrono::milliseconds patience) {
  constexpr auto kPause = std::chrono::milliseconds(20);
  // The folder's, since the file may not be there yet, and is another one each time it is written.
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  const std::string name = folder.empty() ? "." : folder.string();
  const auto opened = std::make_shared<Descriptor>(::open(name.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!opened->valid()) return failure(fmt::format("{}: cannot open: {}", name, reason(errno)));
  const auto end = std::chrono::steady_clock::now() + patience;
  // flock() waits for ever or not at all.
  while (::flock(opened->get(), LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK && errno != EINTR)
      return failure(fmt::format("{}: cannot lock: {}", name, reason(errno)));
    if (std::chrono::steady_clock::now() >= end)
      return failure(fmt::format(
          "{}: another process is changing a file of its folder: try again when it has ended", path));
    std::this_thread::sleep_for(kPause);
  }
  return FileLock(opened);
}

}  // namespace clampd
