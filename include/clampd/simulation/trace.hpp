#pragma once

#include <boost/lockfree/spsc_queue.hpp>
#include <cstdint>
#include <string>

#include "clampd/base/realtime.hpp"
#include "clampd/base/result.hpp"

namespace clampd::plant {

/// What really was at one sampling instant, whatever the readings said.
struct TraceRow {
  std::int64_t time_ns = 0;  ///< CLOCK_MONOTONIC
  std::int64_t sample = 0;
  double torque_Nm = 0.0;  ///< acting from this instant until the next
  double force_N = 0.0;
  double velocity_rad_s = 0.0;
  double position_rad = 0.0;
  bool enabled = false;
  bool watchdog = false;
  bool fault = false;  ///< reported by the brake, e.g. since its link failed
};

/// A CSV file of the brake's truth. The brake's thread puts rows, another one writes them; whole lines only,
/// and into the file at every flush, so that little is lost when the process is killed.
class Trace {
 public:
  static Result<Trace> create(const std::string& path);
  Trace(Trace&& other) noexcept;
  Trace& operator=(Trace&&) = delete;
  ~Trace();

  CLAMPD_REALTIME void put(const TraceRow& row) noexcept;
  /// Writes what was put. Not for the brake's thread.
  Result<void> flush();
  std::uint64_t dropped() const noexcept {
    return dropped_;
  }  ///< to be read once the brake's thread has ended

 private:
  static constexpr std::size_t kRows = 8192;
  using Queue = boost::lockfree::spsc_queue<TraceRow, boost::lockfree::capacity<kRows>>;

  Trace(std::string path, int descriptor) : path_{std::move(path)}, descriptor_{descriptor} {}

  std::string path_;
  int descriptor_;
  std::unique_ptr<Queue> queue_ = std::make_unique<Queue>();
  std::uint64_t dropped_ = 0;
  std::string lines_;
};

}  // namespace clampd::plant
