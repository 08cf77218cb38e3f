#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "src/drive/data_check.hpp"

namespace clampd::data_check {
namespace {

/// A change of position from one row to the next that the motion about it does not explain.
struct Leap {
  std::size_t row = 0;  ///< the first one after it
  double size = 0.0;    ///< less what the motion itself moves
  double motion = 0.0;  ///< what the motion moves in that row, by the rows about it
};

double median_of_five(std::array<double, 5> values) {
  std::nth_element(values.begin(), values.begin() + 2, values.end());
  return values[2];
}

/// Per second, so that a gap in the time stamps is no leap.
std::vector<double> rates_of(const Run& run) {
  std::vector<double> rates(run.size(), 0.0);
  for (std::size_t i = 1; i < run.size(); ++i)
    rates[i] = (run.position_rad[i] - run.position_rad[i - 1]) / (run.time_s[i] - run.time_s[i - 1]);
  return rates;
}

std::vector<Leap> leaps_of(const Run& run) {
  // The rows about a leap move at their own rates; ten times the fastest of them is no acceleration.
  constexpr double kTimesMotion = 10.0, kLeastLeap = 20.0;
  constexpr std::size_t kReach = 5;
  const std::vector<double>& x = run.position_rad;
  const std::vector<double> rates = rates_of(run);
  const double noise = noise_of(x), step = step_of(x);
  std::vector<double> fast;
  for (const double rate : rates) fast.push_back(std::abs(rate));
  const double usual = quantile(std::move(fast), 0.99);
  std::vector<Leap> leaps;
  for (std::size_t i = kReach + 1; i + kReach < x.size(); ++i) {
    const double step_s = run.time_s[i] - run.time_s[i - 1];
    const double change = std::abs(x[i] - x[i - 1]);
    // Cheap first: hardly any row gets past these.
    if (change < kLeastLeap * std::max(step, noise) || std::abs(rates[i]) <= 1.5 * usual) continue;
    double before = 0.0, after = 0.0;
    std::array<double, 5> earlier{}, later{};
    for (std::size_t k = 0; k < kReach; ++k) {
      earlier[k] = rates[i - 1 - k];
      later[k] = rates[i + 1 + k];
      before = std::max(before, std::abs(earlier[k]));
      after = std::max(after, std::abs(later[k]));
    }
    const double motion = 0.5 * (median_of_five(earlier) + median_of_five(later)) * step_s;
    if (std::abs(rates[i]) < kTimesMotion * std::max(before, after)) continue;
    leaps.push_back({i, x[i] - x[i - 1] - motion, motion});
  }
  return leaps;
}

/// The modulus of a counter that wraps: all leaps are of one size, and each against the motion; NaN
/// otherwise.
double modulus_of(const std::vector<Leap>& leaps, std::span<const double> x, double step) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  if (leaps.empty()) return kNone;
  std::vector<double> sizes;
  for (const Leap& leap : leaps) sizes.push_back(std::abs(leap.size));
  const double modulus = quantile(sizes, 0.5);
  const auto [least, most] = std::ranges::minmax(x);
  // Within a modulus and no farther, all the time.
  if (most - least > 1.05 * modulus || most - least < 0.7 * modulus) return kNone;
  double fastest = 0.0;
  for (const Leap& leap : leaps) fastest = std::max(fastest, std::abs(leap.motion));
  for (const Leap& leap : leaps) {
    if (std::abs(std::abs(leap.size) - modulus) > 0.02 * modulus + fastest) return kNone;
    if (leap.size * leap.motion > 0.0 && std::abs(leap.motion) > 2.0 * step) return kNone;
  }
  double nearest = modulus, distance = 0.02;
  for (const double known : {2.0 * M_PI, 360.0, M_PI, 1.0, 4.0 * M_PI}) {
    if (std::abs(modulus / known - 1.0) > distance) continue;
    nearest = known;
    distance = std::abs(modulus / known - 1.0);
  }
  // One leap alone is a wrap only where its size is one of a counter.
  return leaps.size() >= 2 || nearest != modulus ? nearest : kNone;
}

/// The position stays where the leap has brought it.
bool stays(const Leap& leap, std::span<const double> x) {
  const double later = x[std::min(x.size() - 1, leap.row + 4)] - x[leap.row - 1];
  return std::abs(later - leap.size) < 0.3 * std::abs(leap.size) + 6.0 * std::abs(leap.motion);
}

void unwrap(std::vector<double>& x, double modulus) {
  double turns = 0.0, last = x.front();
  for (double& value : x) {
    turns -= std::round((value - last) / modulus);
    last = value;
    value += turns * modulus;
  }
}

}  // namespace

void check_wraps_and_jumps(RunCheck& check) {
  std::vector<double>& x = check.run.position_rad;
  constexpr std::size_t kLeastRows = 20;
  if (x.size() < kLeastRows) return;
  const std::vector<Leap> leaps = leaps_of(check.run);
  if (leaps.empty()) return;
  const Channel channel = channels_of(check).back();
  if (const double modulus = modulus_of(leaps, x, step_of(x)); modulus > 0.0) {
    unwrap(x, modulus);
    check.mended = true;
    check.add("wrap", channel.column, modulus, std::string(channel.unit), DataSeverity::Mended,
              fmt::format("column {} starts again {} by {:.6g} {}, against the motion: a counter that wraps. "
                          "It was unwrapped; write "
                          "wrap = {:.10g} (in units of the column) into the model file if that is right",
                          channel.column, leaps.size() == 1 ? "once" : fmt::format("{} times", leaps.size()),
                          modulus, channel.unit,
                          modulus / check.model.columns.position.value_or(ColumnSource{}).scale));
    return;
  }
  std::vector<Leap> jumps;
  std::ranges::copy_if(leaps, std::back_inserter(jumps), [&](const Leap& leap) { return stays(leap, x); });
  if (jumps.empty()) return;
  const Leap largest =
      *std::ranges::max_element(jumps, {}, [](const Leap& leap) { return std::abs(leap.size); });
  for (const Leap& jump : jumps)
    for (std::size_t i = jump.row; i < x.size(); ++i) x[i] -= jump.size;
  check.mended = true;
  check.add("jump", channel.column, largest.size, std::string(channel.unit), DataSeverity::Mended,
            fmt::format("column {} jumps {} within a row, where the drive cannot have moved so far; the "
                        "largest is {:.3g} {} at "
                        "{:.6g} s. The position was continued as if it had not jumped, so that places before "
                        "and after differ by "
                        "that much; look for a reset of the encoder, lost counts or rows that were cut out",
                        channel.column, jumps.size() == 1 ? "once" : fmt::format("{} times", jumps.size()),
                        largest.size, channel.unit, check.run.time_s[largest.row]));
}

}  // namespace clampd::data_check
