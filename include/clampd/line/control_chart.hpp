#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

namespace clampd::quality {

/// What a run of points says is not chance. Nelson's eight (Journal of Quality Technology 16, 1984), and the
/// one of the Western Electric handbook that they lack.
enum class Rule : std::uint8_t {
  BeyondLimits,    ///< Nelson 1, Western Electric 1: one point beyond 3 sigma
  NineOnOneSide,   ///< Nelson 2
  SixTrending,     ///< Nelson 3: six in a row rise, or fall
  Alternating,     ///< Nelson 4: fourteen in a row go up and down by turns
  TwoOfThree,      ///< Nelson 5, Western Electric 2: beyond 2 sigma on one side
  FourOfFive,      ///< Nelson 6, Western Electric 3: beyond 1 sigma on one side
  FifteenWithin,   ///< Nelson 7: within 1 sigma of the centre
  EightBeyond,     ///< Nelson 8: none within 1 sigma, on both sides
  EightOnOneSide,  ///< Western Electric 4
};
std::string_view name(Rule rule) noexcept;         ///< "Nelson 5 (Western Electric 2)"
std::string_view description(Rule rule) noexcept;  ///< "two of three points beyond 2 sigma on one side"

enum class RuleSet : std::uint8_t { Nelson, WesternElectric };

/// A rule that the points up to and including `at` break.
struct Signal {
  std::size_t at = 0;
  Rule rule = Rule::BeyondLimits;
};

/// All signals, by point and then by rule.
std::vector<Signal> signals(std::span<const double> points, double centre, double sigma,
                            RuleSet rules = RuleSet::Nelson);

struct ControlChart {
  std::vector<double> points;
  double centre = 0.0;
  double lower = 0.0;
  double upper = 0.0;
  std::vector<Signal> signals;
};

/// The chart of where the process is and the one of how much it scatters; of the latter only points beyond
/// its limits are signals, since its points are not normal.
struct ChartPair {
  ControlChart location;
  ControlChart spread;
  double sigma = 0.0;  ///< of a single value, short-term
};

/// Individual values and moving ranges of two; point i of the spread chart is |value i+1 - value i|. At least
/// two values.
ChartPair individuals_chart(std::span<const double> values, RuleSet rules = RuleSet::Nelson);

/// Means and ranges (Xbar-R) or standard deviations (Xbar-S) of subgroups of equal size, 2 to 100. At least
/// two subgroups.
ChartPair mean_range_chart(std::span<const std::vector<double>> subgroups, RuleSet rules = RuleSet::Nelson);
ChartPair mean_deviation_chart(std::span<const std::vector<double>> subgroups,
                               RuleSet rules = RuleSet::Nelson);

}  // namespace clampd::quality
