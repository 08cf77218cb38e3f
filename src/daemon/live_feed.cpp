#include "clampd/daemon/live_feed.hpp"

#include <algorithm>

namespace clampd::daemon {

void LiveFeed::take(const Sample& sample) {
  if (sample.trajectory_index < 0) {
    last_index_ = -1;
    return;
  }
  const std::lock_guard lock(mutex_);
  if (sample.trajectory_index <= last_index_ || last_index_ < 0) {
    ++run_;
    repeat_ = sample.repeat;
    trajectory_ = sample.trajectory;
    force_N_.clear();
    velocity_rad_s_.clear();
    torque_Nm_.clear();
  }
  last_index_ = sample.trajectory_index;
  force_N_.push_back(sample.force_N);
  velocity_rad_s_.push_back(sample.velocity_rad_s);
  torque_Nm_.push_back(sample.torque_Nm);
}

nlohmann::ordered_json LiveFeed::since(std::uint64_t run, std::size_t row) const {
  const std::lock_guard lock(mutex_);
  const std::size_t from = run == run_ ? std::min(row, force_N_.size()) : 0;
  const auto rest = [from](const std::vector<double>& values) {
    return std::vector<double>(values.begin() + static_cast<std::ptrdiff_t>(from), values.end());
  };
  return {{"run", run_},
          {"repeat", repeat_},
          {"trajectory", trajectory_},
          {"from", from},
          {"force_N", rest(force_N_)},
          {"velocity_rad_s", rest(velocity_rad_s_)},
          {"torque_Nm", rest(torque_Nm_)}};
}

}  // namespace clampd::daemon
