#pragma once

#include <cstdint>

namespace clampd {

inline constexpr std::int64_t kNanosecondsPerSecond = 1'000'000'000;
inline constexpr std::int64_t kNanosecondsPerMillisecond = 1'000'000;

/// The period that the loop, the brake's sampling and the rows of a trajectory share, unless the brake's
/// frames are slower: then it is theirs (can::ProtocolCodec::period_ns, NominalDrive::period_s).
inline constexpr std::int64_t kPeriod_ns = kNanosecondsPerMillisecond;
inline constexpr double kPeriod_s = 1e-3;

/// CLOCK_MONOTONIC now, in nanoseconds. Only the edges (threads, sockets) read clocks;
/// control law, supervisor and protocol take time as an argument.
std::int64_t monotonic_now_ns() noexcept;

}  // namespace clampd
