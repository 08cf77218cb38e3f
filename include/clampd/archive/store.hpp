#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// Which checks to list, newest first. Empty fields do not restrict.
struct CheckFilter {
  std::string serial = {};
  std::optional<Verdict> verdict = {};
  std::string since = {};  ///< RFC 3339 or a date: checks started then or later
  std::uint32_t limit = 50;
};

/// One line of a list of checks.
struct CheckSummary {
  std::string id;
  std::string serial;
  std::string started;
  Verdict verdict = Verdict::Error;
  bool marginal = false;
  bool simulated = false;
  std::uint32_t repeats = 0;
  double duration_s = 0.0;
  std::string reason;
};

/// The station's results: one SQLite file, write-ahead logged and synced at every commit, so that a saved
/// check survives a power cut. Several processes may read while one writes. Not for use by two threads at
/// once.
class CheckStore {
 public:
  enum class Access { ReadWrite, ReadOnly };

  /// Opens or (ReadWrite) creates the file and its folder, and brings its schema up to date. A lock held by
  /// another process is waited for as long as `busy_timeout_ms`.
  static Result<CheckStore> open(const std::string& path, Access access = Access::ReadWrite,
                                 int busy_timeout_ms = 5000);

  CheckStore(CheckStore&&) noexcept;
  CheckStore& operator=(CheckStore&&) noexcept;
  ~CheckStore();

  /// The whole record in one transaction. An id that is already there is an error.
  Result<void> save(const CheckRecord& record);

  Result<std::vector<CheckSummary>> list(const CheckFilter& filter) const;

  /// The whole record, its runs' checksums verified. `id` may be shortened as long as it is unambiguous;
  /// "last" is the newest check.
  Result<CheckRecord> load(const std::string& id) const;

 private:
  struct Database;
  explicit CheckStore(std::unique_ptr<Database> database);
  std::unique_ptr<Database> database_;
};

}  // namespace clampd
