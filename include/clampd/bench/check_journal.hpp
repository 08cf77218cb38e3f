#pragma once

#include <optional>
#include <string>
#include <utility>

#include "clampd/archive/store.hpp"
#include "clampd/base/result.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd::bench {

/// The check under way, in a small file beside the database, from its begin until its record is saved: so
/// that a station that is killed in between leaves a record all the same.
class CheckJournal {
 public:
  explicit CheckJournal(std::string file) : file_(std::move(file)) {}

  /// `head`: what is known when a check begins.
  Result<void> begin(const CheckRecord& head) const;
  /// The check is on record.
  Result<void> end() const;

  /// At the station's start: saves the check that was not ended as an ERROR that says so, unless it is on
  /// record. Nothing if there is none. Errors: the file cannot be read, the record cannot be saved; then the
  /// file stays for the next start.
  Result<std::optional<CheckRecord>> recover(CheckStore& store) const;

 private:
  std::string file_;
};

}  // namespace clampd::bench
