#include "clampd/line/control_chart.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "clampd/base/assert.hpp"
#include "clampd/line/constants.hpp"

namespace clampd::quality {
namespace {

struct RuleText {
  std::string_view name;
  std::string_view description;
};

constexpr std::array<RuleText, 9> kRuleTexts{{
    {"Nelson 1 (Western Electric 1)", "a point beyond 3 sigma"},
    {"Nelson 2", "nine points in a row on one side of the centre"},
    {"Nelson 3", "six points in a row rising or falling"},
    {"Nelson 4", "fourteen points in a row alternating up and down"},
    {"Nelson 5 (Western Electric 2)", "two of three points beyond 2 sigma on one side"},
    {"Nelson 6 (Western Electric 3)", "four of five points beyond 1 sigma on one side"},
    {"Nelson 7", "fifteen points in a row within 1 sigma"},
    {"Nelson 8", "eight points in a row beyond 1 sigma on both sides"},
    {"Western Electric 4", "eight points in a row on one side of the centre"},
}};

/// The points up to one of them, in sigmas from the centre: z[0] is the newest.
class Recent {
 public:
  Recent(std::span<const double> points, std::size_t at, double centre, double sigma)
      : points_(points), at_(at), centre_(centre), sigma_(sigma) {}

  double z(std::size_t back) const { return (points_[at_ - back] - centre_) / sigma_; }
  double step(std::size_t back) const { return points_[at_ - back] - points_[at_ - back - 1]; }

  /// At least `least` of the newest `of` satisfy the condition.
  template <class Condition>
  bool some(std::size_t least, std::size_t of, Condition condition) const {
    if (at_ + 1 < of) return false;
    std::size_t count = 0;
    for (std::size_t back = 0; back < of; ++back) count += condition(z(back)) ? 1 : 0;
    return count >= least;
  }
  /// The same on either side, the newest point among them.
  bool beyond_on_a_side(std::size_t least, std::size_t of, double distance) const {
    for (const double side : {1.0, -1.0})
      if (side * z(0) > distance && some(least, of, [&](double z) { return side * z > distance; }))
        return true;
    return false;
  }
  template <class Condition>
  bool all_steps(std::size_t steps, Condition condition) const {
    if (at_ < steps) return false;
    for (std::size_t back = 0; back < steps; ++back)
      if (!condition(back)) return false;
    return true;
  }

  bool breaks(Rule rule) const {
    switch (rule) {
      case Rule::BeyondLimits:
        return std::abs(z(0)) > 3.0;
      case Rule::NineOnOneSide:
        return beyond_on_a_side(9, 9, 0.0);
      case Rule::SixTrending:
        return all_steps(5, [&](std::size_t back) { return step(back) > 0.0; }) ||
               all_steps(5, [&](std::size_t back) { return step(back) < 0.0; });
      case Rule::Alternating:
        return step_signs_alternate(13);
      case Rule::TwoOfThree:
        return beyond_on_a_side(2, 3, 2.0);
      case Rule::FourOfFive:
        return beyond_on_a_side(4, 5, 1.0);
      case Rule::FifteenWithin:
        return some(15, 15, [](double z) { return std::abs(z) < 1.0; });
      case Rule::EightBeyond:
        return some(8, 8, [](double z) { return std::abs(z) > 1.0; }) &&
               some(1, 8, [](double z) { return z > 0.0; }) && some(1, 8, [](double z) { return z < 0.0; });
      case Rule::EightOnOneSide:
        return beyond_on_a_side(8, 8, 0.0);
    }
    return false;
  }

 private:
  bool step_signs_alternate(std::size_t steps) const {
    return all_steps(steps, [&](std::size_t back) {
      return back + 1 == steps ? step(back) != 0.0 : step(back) * step(back + 1) < 0.0;
    });
  }

  std::span<const double> points_;
  std::size_t at_;
  double centre_;
  double sigma_;
};

double mean_of(std::span<const double> values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double range_of(std::span<const double> values) {
  const auto [least, most] = std::minmax_element(values.begin(), values.end());
  return *most - *least;
}

double deviation_of(std::span<const double> values) {
  const double mean = mean_of(values);
  double squares = 0.0;
  for (const double value : values) squares += (value - mean) * (value - mean);
  return std::sqrt(squares / static_cast<double>(values.size() - 1));
}

ControlChart location_chart(std::vector<double> points, double sigma_of_point, RuleSet rules) {
  ControlChart chart;
  chart.centre = mean_of(points);
  chart.lower = chart.centre - 3.0 * sigma_of_point;
  chart.upper = chart.centre + 3.0 * sigma_of_point;
  chart.signals = signals(points, chart.centre, sigma_of_point, rules);
  chart.points = std::move(points);
  return chart;
}

/// `sigma_over_mean`: of a point, for normal values.
ControlChart spread_chart(std::vector<double> points, double sigma_over_mean) {
  ControlChart chart;
  chart.centre = mean_of(points);
  chart.lower = std::max(0.0, chart.centre * (1.0 - 3.0 * sigma_over_mean));
  chart.upper = chart.centre * (1.0 + 3.0 * sigma_over_mean);
  for (std::size_t i = 0; i < points.size(); ++i)
    if (points[i] < chart.lower || points[i] > chart.upper) chart.signals.push_back({i, Rule::BeyondLimits});
  chart.points = std::move(points);
  return chart;
}

/// `spread_of` a subgroup is on average `mean` sigma of a single value, and itself scatters by `sd` sigma.
template <class SpreadOf>
ChartPair subgroup_chart(std::span<const std::vector<double>> subgroups, RuleSet rules, SpreadOf spread_of,
                         double mean, double sd) {
  std::vector<double> means, spreads;
  for (const std::vector<double>& subgroup : subgroups) {
    CLAMPD_ASSERT(subgroup.size() == subgroups.front().size());
    means.push_back(mean_of(subgroup));
    spreads.push_back(spread_of(subgroup));
  }
  ChartPair charts;
  charts.spread = spread_chart(std::move(spreads), sd / mean);
  charts.sigma = charts.spread.centre / mean;
  charts.location = location_chart(
      std::move(means), charts.sigma / std::sqrt(static_cast<double>(subgroups.front().size())), rules);
  return charts;
}

int size_of(std::span<const std::vector<double>> subgroups) {
  CLAMPD_ASSERT(subgroups.size() >= 2 && subgroups.front().size() >= 2);
  return static_cast<int>(subgroups.front().size());
}

}  // namespace

std::string_view name(Rule rule) noexcept {
  return kRuleTexts[static_cast<std::size_t>(rule)].name;
}

std::string_view description(Rule rule) noexcept {
  return kRuleTexts[static_cast<std::size_t>(rule)].description;
}

std::vector<Signal> signals(std::span<const double> points, double centre, double sigma, RuleSet rules) {
  using enum Rule;
  static constexpr std::array kNelson{BeyondLimits, NineOnOneSide, SixTrending,   Alternating,
                                      TwoOfThree,   FourOfFive,    FifteenWithin, EightBeyond};
  static constexpr std::array kWesternElectric{BeyondLimits, TwoOfThree, FourOfFive, EightOnOneSide};
  const std::span<const Rule> all =
      rules == RuleSet::Nelson ? std::span<const Rule>(kNelson) : std::span<const Rule>(kWesternElectric);
  std::vector<Signal> found;
  if (!(sigma > 0.0)) return found;  // equal points: nothing can be told from them
  for (std::size_t at = 0; at < points.size(); ++at)
    for (const Rule rule : all)
      if (Recent(points, at, centre, sigma).breaks(rule)) found.push_back({at, rule});
  return found;
}

ChartPair individuals_chart(std::span<const double> values, RuleSet rules) {
  CLAMPD_ASSERT(values.size() >= 2);
  std::vector<double> ranges;
  for (std::size_t i = 1; i < values.size(); ++i) ranges.push_back(std::abs(values[i] - values[i - 1]));
  ChartPair charts;
  charts.spread = spread_chart(std::move(ranges), range_sd(2) / range_mean(2));
  charts.sigma = charts.spread.centre / range_mean(2);
  charts.location = location_chart({values.begin(), values.end()}, charts.sigma, rules);
  return charts;
}

ChartPair mean_range_chart(std::span<const std::vector<double>> subgroups, RuleSet rules) {
  const int n = size_of(subgroups);
  return subgroup_chart(subgroups, rules, range_of, range_mean(n), range_sd(n));
}

ChartPair mean_deviation_chart(std::span<const std::vector<double>> subgroups, RuleSet rules) {
  const double c4 = deviation_mean(size_of(subgroups));
  return subgroup_chart(subgroups, rules, deviation_of, c4, std::sqrt(1.0 - c4 * c4));
}

}  // namespace clampd::quality
