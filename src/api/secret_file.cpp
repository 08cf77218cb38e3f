#include "clampd/api/secret_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <system_error>

#include <fmt/format.h>

namespace clampd::api {

Result<void> write_secret_file(const std::string& path, std::string_view content, mode_t permissions) {
  const std::filesystem::path target(path);
  const std::filesystem::path folder = target.has_parent_path() ? target.parent_path() : ".";
  std::string temporary = (folder / fmt::format(".{}.XXXXXX", target.filename().string())).string();
  const int file = ::mkostemp(temporary.data(), O_CLOEXEC);  // O_EXCL, for the owner alone
  if (file >= 0) {
    const bool written =
        ::write(file, content.data(), content.size()) == static_cast<ssize_t>(content.size()) &&
        ::fchmod(file, permissions) == 0 && ::fsync(file) == 0;
    const int error = errno;
    const bool closed = ::close(file) == 0;
    if (written && closed && ::rename(temporary.c_str(), path.c_str()) == 0) return {};
    if (!written) errno = error;
  }
  const int error = errno;
  if (file >= 0) ::unlink(temporary.c_str());
  return failure(fmt::format("{}: cannot write: {}", path, std::generic_category().message(error)));
}

}  // namespace clampd::api
