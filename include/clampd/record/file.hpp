#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "clampd/base/result.hpp"

namespace clampd {

/// Whole content of a regular file of at most 256 MiB.
Result<std::string> read_file(const std::string& path);

/// Writes to a temporary file beside `path`, syncs and renames it: nothing half-written is ever left at
/// `path`.
Result<void> write_file_atomically(const std::string& path, std::string_view content);

/// Of several processes that read a file, change it and write it again, one at a time: until the lock is gone.
class FileLock {
 public:
  /// Waits for a process that has a file of the same folder. Errors: it does not let go for so long, or the
  /// folder cannot be locked.
  static Result<FileLock> take(const std::string& path, std::chrono::milliseconds patience);

 private:
  explicit FileLock(std::shared_ptr<const void> folder) : folder_(std::move(folder)) {}
  std::shared_ptr<const void> folder_;  ///< open, and locked as long as it is
};

}  // namespace clampd
