#include "src/drive/noise.hpp"

#include <cmath>
#include <limits>

namespace clampd::drive {
namespace {

/// The noise forgets within this share of a run at most. What is smoother than that is no noise but a torque
/// of the drive's own, such as gravity; how far it misleads is counted by the scatter over blocks
/// (Design::overdispersion) and by what was left out.
constexpr double kLeastIndependent = 100.0;

}  // namespace

Whitener::Whitener(const DriveData& data, const RowNoise& noise) {
  const double memory = noise.memory_share;
  const double white = std::max(1e-9, 1.0 - memory);
  for (const DriveRows& run : data.runs) {
    double variance = memory, last_s = 0.0;
    for (std::size_t i = 0; i < run.size(); ++i) {
      const double time_s = run.time_s[static_cast<Eigen::Index>(i)];
      const double decay = i == 0 ? 0.0 : std::exp(-(time_s - last_s) / noise.memory_s);
      last_s = time_s;
      variance = decay * decay * variance + memory * (1.0 - decay * decay);
      const double innovation = variance + white;
      const double gain = variance / innovation;
      variance *= white / innovation;
      steps_.push_back({decay, gain, 1.0 / std::sqrt(innovation)});
      log_determinant_ += std::log(innovation);
    }
  }
}

Eigen::VectorXd Whitener::operator()(const Eigen::VectorXd& column) const {
  Eigen::VectorXd result(column.size());
  double state = 0.0;
  for (Eigen::Index i = 0; i < column.size(); ++i) {
    const Step& step = steps_[static_cast<std::size_t>(i)];
    const double predicted = step.decay * state;
    const double innovation = column[i] - predicted;
    state = predicted + step.gain * innovation;
    result[i] = innovation * step.scale;
  }
  return result;
}

RowNoise noise_of(const DriveData& data, const Eigen::VectorXd& residuals) {
  double row_s = std::numeric_limits<double>::infinity(), longest_s = 0.0;
  for (const DriveRows& run : data.runs) {
    for (Eigen::Index i = 1; i < run.time_s.size(); ++i)
      row_s = std::min(row_s, run.time_s[i] - run.time_s[i - 1]);
    if (run.time_s.size() > 1)
      longest_s = std::max(longest_s, run.time_s[run.time_s.size() - 1] - run.time_s[0]);
  }
  RowNoise best;
  if (!std::isfinite(row_s)) return best;
  best.memory_s = row_s;
  const auto count = static_cast<double>(residuals.size());
  double least = std::numeric_limits<double>::infinity();
  for (const double share : {0.0, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99}) {
    for (double memory_s = row_s; memory_s < std::max(1.5 * row_s, longest_s / kLeastIndependent);
         memory_s *= 2.0) {
      const RowNoise noise{share, memory_s};
      const Whitener whitener(data, noise);
      const double cost =
          count * std::log(whitener(residuals).squaredNorm() / count) + whitener.log_determinant();
      if (cost < least) {
        least = cost;
        best = noise;
      }
      if (share == 0.0) break;
    }
  }
  return best;
}

}  // namespace clampd::drive
