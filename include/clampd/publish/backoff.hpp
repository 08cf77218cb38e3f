#pragma once

#include <chrono>
#include <cstdint>
#include <random>

namespace clampd::publish {

struct BackoffOptions {
  std::chrono::milliseconds first{500};
  std::chrono::milliseconds longest{60'000};
};

/// How long to wait before the next attempt: doubled with every failure up to the longest, and drawn from the
/// upper half of that, so that the stations of a line do not all come back in the same instant.
class Backoff {
 public:
  Backoff(BackoffOptions options, std::uint64_t seed) : options_(options), generator_(seed) {}

  std::chrono::milliseconds next() {
    std::chrono::milliseconds bound = std::min(bound_, options_.longest);
    bound_ = std::min(2 * bound, options_.longest);
    return std::chrono::milliseconds(
        std::uniform_int_distribution<std::int64_t>((bound.count() + 1) / 2, bound.count())(generator_));
  }
  /// After a success.
  void reset() { bound_ = options_.first; }

 private:
  BackoffOptions options_;
  std::mt19937_64 generator_;
  std::chrono::milliseconds bound_ = options_.first;
};

}  // namespace clampd::publish
