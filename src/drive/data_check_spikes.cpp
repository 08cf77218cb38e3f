#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "src/drive/data_check.hpp"

namespace clampd::data_check {
namespace {

/// Rows [first, first + rows) that leave the readings about them and come back.
struct Spike {
  std::size_t first = 0, rows = 0;
  double size = 0.0;
};

constexpr std::size_t kLongest = 3;  ///< rows of a spike; what lasts longer is no single bad sample
constexpr std::size_t kBlock = 32;

/// The cubic through two readings on each side of rows [first, first + rows), at row `at`.
double across(std::span<const double> x, std::size_t first, std::size_t rows, std::size_t at) {
  const double left = -1.0, right = static_cast<double>(rows);
  const double u = static_cast<double>(at - first);
  const std::array<double, 4> places{left - 1.0, left, right, right + 1.0};
  const std::array<double, 4> values{x[first - 2], x[first - 1], x[first + rows], x[first + rows + 1]};
  double sum = 0.0;
  for (std::size_t i = 0; i < 4; ++i) {
    double weight = values[i];
    for (std::size_t k = 0; k < 4; ++k)
      if (k != i) weight *= (u - places[k]) / (places[i] - places[k]);
    sum += weight;
  }
  return sum;
}

/// For each block of rows the median distance of a reading from the cubic through its neighbours.
std::vector<double> local_scales(std::span<const double> x) {
  std::vector<double> scales, distances;
  for (std::size_t begin = 0; begin < x.size(); begin += kBlock) {
    distances.clear();
    for (std::size_t i = std::max<std::size_t>(begin, 2);
         i < std::min(begin + kBlock, x.size()) && i + 2 < x.size(); ++i)
      distances.push_back(std::abs(x[i] - across(x, i, 1, i)));
    scales.push_back(distances.empty() ? 0.0 : quantile(distances, 0.5));
  }
  return scales;
}

class SpikeSearch {
 public:
  /// `other_velocity`: the motion that may be why a torque has a pulse; empty for other readings.
  SpikeSearch(std::span<const double> x, std::span<const double> other_velocity)
      : x_(x),
        velocity_(other_velocity),
        scales_(local_scales(x)),
        step_(step_of(x)),
        overall_(quantile(scales_, 0.5)) {}

  std::vector<Spike> find() const {
    std::vector<Spike> spikes;
    for (std::size_t i = kMargin; i + kMargin + kLongest < x_.size(); ++i) {
      if (std::abs(x_[i] - x_[i - 1]) < least(i)) continue;
      for (std::size_t rows = 1; rows <= kLongest; ++rows) {
        const double size = spike_size(i, rows);
        if (size == 0.0 || has_moved(i, rows, std::abs(size))) continue;
        spikes.push_back({i, rows, size});
        i += rows;
        break;
      }
    }
    return spikes;
  }

 private:
  static constexpr std::size_t kMargin = 8;
  static constexpr double kObvious =
      10.0;  ///< as large as the whole range of the torque: wrong wherever it is

  /// Twelve median distances are eight standard deviations of normal noise: no chance in a million rows. A
  /// reading in steps may be off by some of them.
  double least(std::size_t i) const {
    const std::size_t block = i / kBlock;
    double scale = 0.5 * overall_;
    for (std::size_t b = block == 0 ? 0 : block - 1; b <= std::min(block + 1, scales_.size() - 1); ++b)
      scale = std::max(scale, scales_[b]);
    return std::max({12.0 * scale, 5.0 * step_, least_});
  }

  /// The largest change from row to row about rows [first, first + rows), theirs left out.
  double largest_change_about(std::size_t first, std::size_t rows) const {
    double largest = 0.0;
    for (std::size_t k = 1; k < kMargin - 1; ++k) {
      largest = std::max(largest, std::abs(x_[first - k] - x_[first - k - 1]));
      if (first + rows + k < x_.size())
        largest = std::max(largest, std::abs(x_[first + rows + k] - x_[first + rows + k - 1]));
    }
    return largest;
  }

  /// 0: no spike.
  double spike_size(std::size_t first, std::size_t rows) const {
    double smallest = std::numeric_limits<double>::infinity(), largest = 0.0;
    for (std::size_t i = first; i < first + rows; ++i) {
      const double off = x_[i] - across(x_, first, rows, i);
      if (largest != 0.0 && off * largest < 0.0) return 0.0;
      smallest = std::min(smallest, std::abs(off));
      if (std::abs(off) > std::abs(largest)) largest = off;
    }
    // What the reading changes by elsewhere within a row it may change by twice, out and back: the apex of a
    // triangle.
    if (smallest < std::max(least(first), 1.5 * largest_change_about(first, rows))) return 0.0;
    // A step is not a spike: it does not come back.
    const double back = std::abs(x_[first + rows] - x_[first - 1]);
    return back < 0.3 * smallest + largest_change_about(first, rows) ? largest : 0.0;
  }

  /// A pulse of torque that the motion answers is none of the logger's: the speed changes more than just
  /// before. About standstill dry friction hides the answer, and those rows tell nothing anyway.
  bool has_moved(std::size_t first, std::size_t rows, double size) const {
    if (velocity_.empty()) return false;
    const auto change = [&](std::size_t from, std::size_t to) {
      return std::abs(velocity_[to] - velocity_[from]);
    };
    const double speed = std::min(std::abs(velocity_[first - 3]), std::abs(velocity_[first + rows + 2]));
    const double before = std::max(change(first - 6, first - 3), change(first - 5, first - 2));
    const double here = std::max(change(first - 2, first + rows + 1), change(first - 2, first + rows + 2));
    return (speed < slow_ && size < kObvious * least_) || here > 3.0 * before + 6.0 * noise_;
  }

  std::span<const double> x_, velocity_;
  std::vector<double> scales_;
  double step_, overall_;
  /// A torque has pulses of its own, at breakaway and in gears; only those that matter to a fit are asked
  /// about.
  double least_ =
      velocity_.empty()
          ? 0.0
          : 0.1 * (quantile({x_.begin(), x_.end()}, 0.99) - quantile({x_.begin(), x_.end()}, 0.01));
  double slow_ = velocity_.empty() ? 0.0
                                   : 0.03 * (quantile({velocity_.begin(), velocity_.end()}, 0.98) -
                                             quantile({velocity_.begin(), velocity_.end()}, 0.02));
  double noise_ = velocity_.empty() ? 0.0 : noise_of(velocity_);
};

}  // namespace

void check_spikes(RunCheck& check) {
  // More than that are no single bad samples, and what is between them is hardly better.
  constexpr double kMost = 0.05;
  constexpr std::size_t kLeastRows = 40;
  if (check.run.size() < kLeastRows) return;
  for (const Channel& channel : channels_of(check)) {
    std::vector<double>& x = *channel.values;
    const bool torque = channel.kind == Channel::Kind::Torque;
    const std::vector<Spike> spikes =
        SpikeSearch(x, torque ? velocity_of(check.run) : std::vector<double>{}).find();
    if (spikes.empty()) continue;
    const Spike largest =
        *std::ranges::max_element(spikes, {}, [](const Spike& spike) { return std::abs(spike.size); });
    const bool mends = static_cast<double>(spikes.size()) <= kMost * static_cast<double>(x.size());
    const std::string what = fmt::format(
        "column {} has {} of one to {} rows that leave{} the readings about and come{} back at once, the "
        "largest by {:.3g} {} at "
        "{:.6g} s",
        channel.column, spikes.size() == 1 ? "a spike" : fmt::format("{} spikes", spikes.size()), kLongest,
        spikes.size() == 1 ? "s" : "", spikes.size() == 1 ? "s" : "", largest.size, channel.unit,
        check.run.time_s[largest.first]);
    if (mends) {
      for (const Spike& spike : spikes) {
        std::array<double, kLongest> values{};
        for (std::size_t k = 0; k < spike.rows; ++k)
          values[k] = across(x, spike.first, spike.rows, spike.first + k);
        for (std::size_t k = 0; k < spike.rows; ++k) x[spike.first + k] = values[k];
      }
      check.mended = true;
    }
    check.add("spikes", channel.column, static_cast<double>(spikes.size()), "spikes",
              mends ? DataSeverity::Mended : DataSeverity::Note,
              what + (mends ? ". They were replaced by the cubic through their neighbours"
                            : ". They are too many to be mended: look for a loose contact or a bus that "
                              "loses messages"));
  }
}

}  // namespace clampd::data_check
