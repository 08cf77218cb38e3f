#include "tests/drive_bench/spoil.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

namespace clampd::drive_bench {
namespace {

using Column = std::vector<double>;

void shift_late(Column& column, std::size_t rows) {
  for (std::size_t k = column.size(); k-- > 0;) column[k] = column[k >= rows ? k - rows : 0];
}

std::size_t late_rows(const Case& c) {
  const double late_s = std::max(0.02, 0.03 / c.motion.frequency_Hz);
  return std::max<std::size_t>(2, static_cast<std::size_t>(std::lround(late_s / c.rig.row_s())));
}

void scale(Column& column, double factor) {
  for (double& value : column) value *= factor;
}

double largest(const Column& column) {
  double result = 0.0;
  for (const double value : column) result = std::max(result, std::abs(value));
  return result;
}

std::size_t some_row(const Column& column, Random& random) {
  const auto count = static_cast<int>(column.size());
  return static_cast<std::size_t>(random.integer(count / 10, count - 1 - count / 10));
}

/// A few single rows, where `replace` makes a difference.
template <class Replace>
void single_rows(Column& column, Random& random, Replace replace) {
  const double most = largest(column);
  const int wanted = random.integer(1, 6);
  for (int done = 0, attempt = 0; done < wanted && attempt < 1000; ++attempt) {
    double& value = column[some_row(column, random)];
    if (std::abs(value) < 0.4 * most) continue;
    value = replace(value, most);
    ++done;
  }
}

void hold(Recording& run, int rows) {
  const auto every = static_cast<std::size_t>(rows);
  for (Column* column : {&run.torque, &run.position, &run.velocity})
    for (std::size_t k = 0; k < column->size(); ++k) (*column)[k] = (*column)[k - k % every];
}

void clip(Column& torque) {
  Column sorted = torque;
  for (double& value : sorted) value = std::abs(value);
  std::sort(sorted.begin(), sorted.end());
  const double limit = std::min(sorted[sorted.size() * 85 / 100], 0.85 * sorted.back());
  for (double& value : torque) value = std::clamp(value, -limit, limit);
}

void leave_gap(Recording& run, Random& random) {
  const auto count = static_cast<long>(run.time_s.size());
  const long gap = std::min<long>(count / 8, random.integer(20, 200)),
             from = static_cast<long>(some_row(run.time_s, random)) - gap / 2;
  for (Column* column : {&run.time_s, &run.torque, &run.position, &run.velocity})
    column->erase(column->begin() + std::max(0L, from), column->begin() + std::max(0L, from) + gap);
}

void jitter(Recording& run, double row_s, Random& random) {
  const double width = random.uniform(0.2, 0.45);
  for (double& time : run.time_s) time += width * row_s * random.uniform(-1.0, 1.0);
}

void spoil_run(const Case& c, Recording& run, Random random) {
  const std::string& how = c.spoil;
  Column& column = random.chance(0.4) ? run.position : random.chance(0.5) ? run.velocity : run.torque;
  if (how == "velocity-in-rpm") scale(run.velocity, 60.0 / (2.0 * std::numbers::pi));
  if (how == "velocity-times-0.008") scale(run.velocity, 0.008);
  if (how == "velocity-negated") scale(run.velocity, -1.0);
  if (how == "velocity-late") shift_late(run.velocity, late_rows(c));
  if (how == "torque-negated") scale(run.torque, -1.0);
  if (how == "torque-late") shift_late(run.torque, late_rows(c));
  if (how == "position-in-degrees") scale(run.position, 180.0 / std::numbers::pi);
  if (how == "position-in-mm") scale(run.position, 1000.0);
  if (how == "swapped-torque-velocity") std::swap(run.torque, run.velocity);
  if (how == "swapped-position-velocity") std::swap(run.position, run.velocity);
  if (how == "rows-repeated") hold(run, 3 + static_cast<int>(c.seed % 13));
  if (how == "position-jump")
    for (std::size_t k = some_row(run.position, random); k < run.position.size(); ++k)
      run.position[k] += 0.4 * detail::travel(c);
  if (how == "single-spikes")
    single_rows(column, random, [&](double value, double most) {
      return value + random.sign() * most * random.uniform(3.0, 30.0);
    });
  if (how == "single-zeros") single_rows(column, random, [](double, double) { return 0.0; });
  if (how == "counter-wraps") {
    const double turn = detail::travel(c) * (0.7 + 0.05 * static_cast<double>(c.seed % 10));
    for (double& value : run.position) value -= turn * std::floor(value / turn);
  }
  if (how == "torque-clipped") clip(run.torque);
  if (how == "stamps-jitter") jitter(run, c.rig.row_s(), random);
  if (how == "stamps-gap") leave_gap(run, random);
  if (how == "cells-nan")
    single_rows(column, random, [](double, double) { return std::numeric_limits<double>::quiet_NaN(); });
}

}  // namespace

void spoil(const Case& c, std::vector<Recording>& runs) {
  if (c.spoil.empty()) return;
  Random random(c.seed, 300);
  for (std::size_t run = 0; run < runs.size(); ++run) spoil_run(c, runs[run], Random(c.seed, 301 + run));
}

const std::vector<std::string>& accepted_findings(const std::string& spoil) {
  static const std::map<std::string, std::vector<std::string>> kAccepted{
      {"velocity-in-rpm", {"velocity-scale", "unit"}},
      {"velocity-times-0.008", {"velocity-scale", "unit"}},
      {"velocity-negated", {"velocity-sign"}},
      {"velocity-late", {"velocity-delay"}},
      {"torque-negated", {"torque-sign"}},
      {"torque-late", {"torque-delay"}},
      {"position-in-degrees", {"velocity-scale", "unit"}},
      {"position-in-mm", {"velocity-scale", "unit"}},
      {"swapped-torque-velocity",
       {"velocity-scale", "velocity-sign", "velocity-delay", "unit", "torque-sign"}},
      {"swapped-position-velocity", {"velocity-scale", "velocity-sign", "velocity-delay", "unit"}},
      {"rows-repeated", {"held-readings"}},
      {"position-jump", {"jump", "wrap"}},
      {"single-spikes", {"spikes"}},
      {"single-zeros", {"spikes"}},
      {"counter-wraps", {"wrap", "jump"}},
      {"torque-clipped", {"clipped"}},
      {"stamps-jitter", {"time-jitter"}},
      {"stamps-gap", {"time-gap"}},
      {"cells-nan", {}},  // an error, or a finding of any name
      {"standstill", {"standstill"}},
      {"resolution", {"resolution"}},
      {"sampling-too-slow", {"sampling-too-slow"}},
      {"one-direction", {"one-direction"}},
  };
  static const std::vector<std::string> kNone;
  const auto found = kAccepted.find(spoil);
  return found == kAccepted.end() ? kNone : found->second;
}

namespace detail {
const std::vector<std::string>& spoils() {
  static const std::vector<std::string> kSpoils{"velocity-in-rpm",
                                                "velocity-times-0.008",
                                                "velocity-negated",
                                                "velocity-late",
                                                "torque-negated",
                                                "torque-late",
                                                "position-in-degrees",
                                                "position-in-mm",
                                                "rows-repeated",
                                                "position-jump",
                                                "single-spikes",
                                                "single-zeros",
                                                "counter-wraps",
                                                "torque-clipped",
                                                "stamps-jitter",
                                                "stamps-gap",
                                                "cells-nan",
                                                "standstill",
                                                "resolution",
                                                "sampling-too-slow",
                                                "one-direction",
                                                "swapped-torque-velocity",
                                                "swapped-position-velocity"};
  return kSpoils;
}
}  // namespace detail

}  // namespace clampd::drive_bench
