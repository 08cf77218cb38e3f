#pragma once

#include <cstdint>
#include <mutex>
#include <vector>

#include <nlohmann/json.hpp>

#include "clampd/record/sample.hpp"

namespace clampd::daemon {

/// The present or last run of the trajectory, row by row, for the screen to draw while it happens. Fed by the
/// thread that empties the ring, read by the control API's: the real-time path knows nothing of it.
class LiveFeed {
 public:
  void take(const Sample& sample);

  /// The rows from `row` on, if `run` is still the run under way; else all of it. "run" counts the runs since
  /// the daemon started, 0: there was none. Readings as the brake gave them, not tared.
  nlohmann::ordered_json since(std::uint64_t run, std::size_t row) const;

 private:
  std::int32_t last_index_ = -1;
  mutable std::mutex mutex_;  ///< guards all below
  std::uint64_t run_ = 0;
  std::uint16_t repeat_ = 0;
  std::uint8_t trajectory_ = 0;
  std::vector<double> force_N_;
  std::vector<double> velocity_rad_s_;
  std::vector<double> torque_Nm_;
};

}  // namespace clampd::daemon
