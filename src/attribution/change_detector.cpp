#include "clampd/attribution/change_detector.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "clampd/statistics/distributions.hpp"

namespace clampd::attribution {
namespace {

/// Sizes of the change that share the bet equally, to both sides, in standard deviations of a usual reading.
constexpr std::array<double, 4> kSizes{0.25, 0.5, 1.0, 2.0};

/// A residual counts for no more, so that one odd reading alone is no alarm. The expectation of exp(d z -
/// d^2/2) for a normal z only becomes smaller for it: what is cut off at one end is more than what is added
/// at the other, since the exponential is convex.
constexpr double kMostResidual = 3.0;

/// The standard normal quantile of the probability of this value of Student's t.
double normal_of_student(double t, double degrees) {
  const double tail = 0.5 * statistics::fisher_f_p_value(t * t, 1.0, degrees);
  const double z = tail > 1e-9 ? -statistics::normal_quantile(tail) : kMostResidual;
  return std::copysign(std::min(z, kMostResidual), t);
}

}  // namespace

void ChangeDetector::add(double time_s, double reading, double variance) {
  State& s = state_;
  const double difference = reading - s.mean;
  if (s.readings >= 2) {
    s.starts.push_back({time_s, s.information, s.mean, s.score, s.weight});
    if (s.starts.size() > kMostStarts) s.starts.erase(s.starts.begin());
    const double degrees = static_cast<double>(s.readings) - 1.0;
    const double relative = variance + 1.0 / s.information;  // of the difference, in the readings' variance
    const double sd = std::sqrt(s.squares / degrees * relative);
    const double z = sd > 0.0 ? normal_of_student(difference / sd, degrees) : 0.0;
    // A change by d before which the information was I moves this residual's mean by d I gain.
    const double gain = 1.0 / (s.information * std::sqrt(relative));
    s.score += gain * z;
    s.weight += gain * gain;
  }
  const double before = s.information;
  s.information += 1.0 / variance;
  s.mean += difference / (variance * s.information);
  s.squares += difference * difference * before / (variance * s.information);
  ++s.readings;
}

double ChangeDetector::evidence_of(const Start& start) const {
  const double score = state_.score - start.score, weight = state_.weight - start.weight;
  double sum = 0.0;
  for (const double size : kSizes) {
    const double moved = size * start.information;
    const double rest = -0.5 * moved * moved * weight;
    sum += std::exp(std::min(700.0, moved * score + rest)) + std::exp(std::min(700.0, -moved * score + rest));
  }
  return sum / (2.0 * kSizes.size());
}

double ChangeDetector::evidence() const {
  double sum = 0.0;
  for (const Start& start : state_.starts) sum += evidence_of(start);
  return sum;
}

ChangeDetector::Change ChangeDetector::change() const {
  const State& s = state_;
  const auto best =
      std::max_element(s.starts.begin(), s.starts.end(),
                       [this](const Start& a, const Start& b) { return evidence_of(a) < evidence_of(b); });
  if (best == s.starts.end()) return {};
  const double after = s.information - best->information;
  const double mean_after = (s.information * s.mean - best->information * best->mean) / after;
  const double size = mean_after - best->mean;
  const double between = size * size * best->information * after / s.information;
  const double variance =
      std::max(0.0, s.squares - between) / std::max(1.0, static_cast<double>(s.readings) - 2.0);
  return {best->time_s, size, std::sqrt(variance * (1.0 / best->information + 1.0 / after))};
}

}  // namespace clampd::attribution
