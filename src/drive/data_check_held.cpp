#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include <fmt/format.h>

#include "src/drive/data_check.hpp"

namespace clampd::data_check {
namespace {

/// Where a reading is held for some rows and then changes by several of its steps at once.
struct Holds {
  std::vector<bool> renewed;    ///< a row: a new reading
  std::size_t held_rows = 0;    ///< rows that repeat one
  double share = 0.0;           ///< of the rows in which the reading is not at rest
  std::size_t period_rows = 1;  ///< median distance of renewals, weighted by rows
  std::size_t count = 0;
  bool is_rule = false;  ///< most new readings are held: it is renewed more slowly than the rows come
};

/// A longer repetition is rest, not a reading that waits for its renewal; where most readings are not held,
/// some rows are the most that a logger loses at once.
constexpr std::size_t kLongestHold = 200, kLongestLoss = 5;
/// A change of fewer steps after a repetition may be an encoder's next count.
constexpr double kLeastSteps = 3.0;

/// A position that was held for some rows makes up for them at once: it then moves farther than in the rows
/// about, of which two may have been held themselves.
bool catches_up(std::span<const double> x, std::size_t first, std::size_t end) {
  constexpr std::size_t kReach = 4;
  if (first < kReach + 1 || end + kReach >= x.size()) return false;
  std::array<double, 2 * kReach> about{};
  for (std::size_t k = 1; k <= kReach; ++k) {
    about[2 * k - 2] = std::abs(x[first - k] - x[first - k - 1]);
    about[2 * k - 1] = std::abs(x[end + k] - x[end + k - 1]);
  }
  std::nth_element(about.begin(), about.begin() + 2, about.end(), std::greater{});
  return std::abs(x[end] - x[end - 1]) > 1.4 * about[2];
}

/// The repetitions of at most `longest` rows between large changes that are accepted, by their first row and
/// the one after.
template <class Accepted>
Holds holds_where(std::span<const double> x, std::size_t longest, const Accepted& accepted) {
  const double step = step_of(x);
  Holds holds;
  holds.renewed.assign(x.size(), true);
  std::vector<double> periods;
  std::size_t changes = 0;
  bool large_before = false;
  for (std::size_t i = 1, end = 1; i < x.size(); i = end + 1) {
    for (end = i; end < x.size() && x[end] == x[end - 1];) ++end;
    const std::size_t repeats = end - i;
    const bool large_after = end < x.size() && std::abs(x[end] - x[end - 1]) >= kLeastSteps * step;
    if (end < x.size()) ++changes;
    if (repeats > 0 && repeats <= longest && large_before && large_after && accepted(i, end)) {
      for (std::size_t k = i; k < end; ++k) holds.renewed[k] = false;
      holds.held_rows += repeats;
      ++holds.count;
      periods.insert(periods.end(), repeats + 1, static_cast<double>(repeats + 1));
    } else if (repeats == 0) {
      periods.push_back(1.0);
    }
    large_before = large_after;
  }
  holds.share = static_cast<double>(holds.held_rows) /
                static_cast<double>(std::max<std::size_t>(1, holds.held_rows + changes));
  holds.is_rule = 2 * holds.count > changes;
  if (!periods.empty()) holds.period_rows = static_cast<std::size_t>(quantile(std::move(periods), 0.5));
  return holds;
}

Holds holds_of(const Channel& channel) {
  const std::span<const double> x(*channel.values);
  Holds slow = holds_where(x, kLongestHold, [](std::size_t, std::size_t) { return true; });
  if (slow.is_rule) return slow;
  if (channel.kind == Channel::Kind::Position)
    return holds_where(x, kLongestLoss,
                       [x](std::size_t first, std::size_t end) { return catches_up(x, first, end); });
  // A velocity or torque of exactly zero may be rest, and one at its extreme a limit.
  const auto [least, most] = std::ranges::minmax(x);
  return holds_where(x, kLongestLoss, [x, least = least, most = most](std::size_t first, std::size_t) {
    return x[first] != 0.0 && x[first] != least && x[first] != most;
  });
}

/// How often a noisy reading in coarse steps repeats itself by chance: with a median change of m steps, in
/// some 0.3 / m of the rows; three times that is no chance.
double chance_of_repeats(std::span<const double> x) {
  std::vector<double> changes;
  for (std::size_t i = 1; i < x.size(); ++i)
    if (x[i] != x[i - 1]) changes.push_back(std::abs(x[i] - x[i - 1]));
  const double step = step_of(x);
  return changes.empty() || step == 0.0 ? 1.0 : step / quantile(std::move(changes), 0.5);
}

void interpolate_held(std::span<const double> time_s, std::vector<double>& x,
                      const std::vector<bool>& renewed) {
  for (std::size_t i = 1; i < x.size(); ++i) {
    if (renewed[i]) continue;
    std::size_t end = i;
    while (end < x.size() && !renewed[end]) ++end;
    if (end == x.size()) return;
    for (std::size_t k = i; k < end; ++k)
      x[k] = x[i - 1] + (x[end] - x[i - 1]) * (time_s[k] - time_s[i - 1]) / (time_s[end] - time_s[i - 1]);
    i = end;
  }
}

/// Rows with a new reading, and in long rests one every `period`.
void keep_renewed(Run& run, const std::vector<bool>& renewed, std::span<const double> x, std::size_t period) {
  std::vector<std::size_t> rows;
  for (std::size_t i = 0; i < run.size(); ++i) {
    const bool changed = i == 0 || (renewed[i] && x[i] != x[i - 1]);
    if (changed || i - rows.back() >= period) rows.push_back(i);
  }
  std::vector<std::vector<double>*> columns{&run.time_s,  &run.torque_Nm,    &run.velocity_rad_s,
                                            &run.force_N, &run.position_rad, &run.drive_enabled};
  for (RunColumn& other : run.others) columns.push_back(&other.values);
  for (std::vector<double>* column : columns) {
    if (column->empty()) continue;
    for (std::size_t k = 0; k < rows.size(); ++k) (*column)[k] = (*column)[rows[k]];
    column->resize(rows.size());
  }
}

}  // namespace

void check_held(RunCheck& check) {
  // One repetition, or two, may be chance, and as few do not matter.
  constexpr double kLeast = 0.002;
  constexpr std::size_t kFewest = 3;
  std::size_t slowest = 0, period = 1;
  std::vector<Channel> channels = channels_of(check);
  std::vector<Holds> holds;
  for (std::size_t c = 0; c < channels.size(); ++c) {
    const Channel& channel = channels[c];
    // A command that acts until the next row is constant on purpose.
    const bool command = channel.kind == Channel::Kind::Torque && check.model.torque_held;
    holds.push_back(command ? Holds{} : holds_of(channel));
    const Holds& found = holds.back();
    // That a position also makes up for it is ten times less likely.
    const double chance = chance_of_repeats(*channel.values) *
                          (channel.kind == Channel::Kind::Position && !found.is_rule ? 0.1 : 1.0);
    if (found.count < kFewest || found.share < std::max(kLeast, chance)) {
      holds.back().held_rows = 0;
      continue;
    }
    const bool slow = found.is_rule;
    if (slow && found.period_rows > period) {
      period = found.period_rows;
      slowest = c;
    }
    check.mended = true;
    check.add(
        "held-readings", channel.column,
        slow ? static_cast<double>(found.period_rows) : static_cast<double>(found.held_rows), "rows",
        DataSeverity::Mended,
        slow ? fmt::format(
                   "column {} is renewed only every {} rows and repeats itself in between ({:.0f} % of the "
                   "rows): only "
                   "the rows with a new reading are used. Record it at its own rate, or the others no faster",
                   channel.column, found.period_rows, 100.0 * found.share)
             : fmt::format("column {} repeats its last reading in {} rows in which it should have changed: "
                           "samples were lost. "
                           "They were interpolated",
                           channel.column, found.held_rows));
  }
  const std::vector<double> raw = *channels[slowest].values;
  for (std::size_t c = 0; c < channels.size(); ++c)
    if (holds[c].held_rows > 0 && (period == 1 || c != slowest))
      interpolate_held(check.run.time_s, *channels[c].values, holds[c].renewed);
  if (period > 1) keep_renewed(check.run, holds[slowest].renewed, raw, period);
}

}  // namespace clampd::data_check
