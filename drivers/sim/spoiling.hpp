#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <random>
#include <string_view>
#include <vector>

#include "clampd/ports/brake_port.hpp"
#include "drivers/sim/episode.hpp"

namespace clampd::sim {

/// A reading of the brake, or the encoder that is behind two of them.
enum class Reading : std::uint8_t { Force, Velocity, Position, Torque, Encoder };
inline constexpr std::size_t kReadingCount = 5;
std::string_view to_string(Reading reading) noexcept;  ///< as in the file: "force", ...

/// In which way a reading lies.
enum class Spoil : std::uint8_t {
  Frozen,   ///< stays what it was
  Scaled,   ///< times the amount
  Negated,  ///< has the other sign
  Offset,   ///< plus the amount
  Late,     ///< is the one of `amount` samples ago, at most kLatest
  Noisy,    ///< has white noise of so much
  Silent,   ///< is zero
};
inline constexpr std::size_t kSpoilCount = 7;
std::string_view to_string(Spoil spoil) noexcept;  ///< as in the file: "frozen", ...

inline constexpr std::size_t kLatest = 200;  ///< samples

/// One reading that lies, in frames whose checksums and counters are right.
struct SpoiledReading {
  Reading reading = Reading::Force;
  Spoil spoil = Spoil::Frozen;
  double amount = 0.0;  ///< in the reading's unit, times or samples; without meaning for the others
  Episode when;

  /// Whether it can be then, and the amount means something for this kind.
  bool valid() const noexcept;
};

/// Spoils readings as told. The same seed spoils alike, and what it draws changes no other reading.
class Spoiler {
 public:
  Spoiler(std::vector<SpoiledReading> spoiled, std::uint64_t seed);

  /// Takes each sample once, in order. Allocates nothing.
  /// `force_N`: the true one.
  void apply(BrakeFeedback& feedback, double time_s, double force_N) noexcept;

 private:
  double changed(const SpoiledReading& spoiled, double BrakeFeedback::*member,
                 const BrakeFeedback& before) noexcept;

  std::vector<SpoiledReading> spoiled_;
  std::vector<BrakeFeedback> at_begin_;  ///< the last sample before each began
  std::vector<bool> begun_;
  std::array<BrakeFeedback, kLatest + 1> history_{};  ///< unspoiled, a ring
  std::size_t samples_ = 0;
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_{0.0, 1.0};
};

}  // namespace clampd::sim
