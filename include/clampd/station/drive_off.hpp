#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>

#include "clampd/record/run.hpp"
#include "clampd/record/sample.hpp"

namespace clampd {

/// What a brake reads while its drive is off: the latest stretch without a gap, once the current has died
/// away.
class DriveOffReadings {
 public:
  /// At most so many rows, the latest.
  explicit DriveOffReadings(std::size_t most_rows = 3000) : most_rows_(most_rows) {}

  void consume(const Sample& sample);
  std::size_t rows() const { return samples_.size(); }
  /// Time from the first row, readings as they come; drive_enabled is 0 in every row.
  Run run() const;

 private:
  std::size_t most_rows_;
  std::size_t waited_ = 0;  ///< samples since the drive was switched off, or since a gap
  std::optional<std::int64_t> last_index_;
  std::deque<Sample> samples_;
};

}  // namespace clampd
