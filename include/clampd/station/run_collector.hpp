#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "clampd/record/run.hpp"
#include "clampd/record/sample.hpp"

namespace clampd {

/// Readings at rest in the clearance: their means are the offsets, their scatter the sensors' noise.
struct Tare {
  std::uint64_t samples = 0;
  double force_offset_N = 0.0;
  double velocity_offset_rad_s = 0.0;
  double force_sd_N = 0.0;
  double velocity_sd_rad_s = 0.0;
};

/// One repeat of the trajectory, tared, on the brake's sample clock (time_s is 0 in its first row).
struct CollectedRun {
  Run run;
  std::uint16_t repeat = 0;
  std::uint8_t trajectory = 0;  ///< of the check's, which it follows
  double tracking_rms_N = 0.0;  ///< tared force minus reference
  double tracking_max_N = 0.0;
};

/// Cuts the loop's stream of samples into runs. A run whose rows are not consecutive in the brake's sample
/// count, or not as many as the trajectory has, is not given out: problem() then says why.
class RunCollector {
 public:
  /// `rows`: of the trajectory.
  explicit RunCollector(std::size_t rows);

  /// In the order of the ring. Gives a run with the sample that completes it.
  std::optional<CollectedRun> consume(const Sample& sample);

  /// The encoder's reading in the first sample of the check, before the station has moved anything.
  std::optional<double> found_rad() const { return found_rad_; }
  const Tare& tare() const { return tare_; }
  std::uint64_t samples() const { return samples_; }
  std::uint64_t samples_lost() const { return samples_lost_; }
  /// From the first to the last sample of the check by the brake's clock: the bench time.
  double duration_s() const;
  /// The first reason for which a run could not be used; empty if there was none.
  const std::string& problem() const { return problem_; }

 private:
  void consume_tare(const Sample& sample);
  void discard(std::string why);

  std::size_t rows_;
  std::uint64_t samples_ = 0;
  std::uint64_t samples_lost_ = 0;
  std::int64_t first_time_ns_ = 0;
  std::optional<double> found_rad_;
  std::optional<Sample> last_;
  Tare tare_;
  double force_squares_ = 0.0;
  double velocity_squares_ = 0.0;
  std::optional<CollectedRun> open_;
  std::int64_t open_start_ns_ = 0;
  double tracking_squares_ = 0.0;
  std::string problem_;
};

}  // namespace clampd
