#include "drive_off.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <Eigen/Core>

#include "clampd/base/clock.hpp"

namespace clampd {

namespace {

constexpr double kShortest_s = 0.5;
constexpr double kLonger = 1.3;
/// The torque reading of a drive is no steadier than this over some seconds.
constexpr double kSteadiest_Nm = 2e-5;

/// Variance of what the rival takes for a torque while the reading stays so, by what is not known of the
/// rival.
double own_variance(const RivalModel& rival, const Eigen::VectorXd& gradient) {
  double variance = 0.0;
  for (Eigen::Index i = 0; i < gradient.size(); ++i)
    for (Eigen::Index j = 0; j < gradient.size(); ++j)
      if (gradient[i] != 0.0 && gradient[j] != 0.0)
        variance += gradient[i] * rival.covariance(i, j) * gradient[j];
  return std::isfinite(variance) ? variance : std::numeric_limits<double>::infinity();
}

/// Expected of the other rival's misfit if the first is true.
double evidence_nats(const RivalModel& truth, const RivalModel& other, double reading_variance) {
  const ExtendedBrake brake(truth.parameters);
  const double at_zero_Nm = brake.acting_torque(0.0);
  const double slope = brake.acting_torque(1.0) - at_zero_Nm;
  const double reading_Nm = -at_zero_Nm / slope;
  const ExtendedBrake judge(other.parameters);
  Eigen::VectorXd gradient(judge.parameters());
  const double taken_Nm = judge.acting_torque(reading_Nm, gradient.data());
  return 0.5 * taken_Nm * taken_Nm / (reading_variance + own_variance(other, gradient));
}

}  // namespace

std::string names_of(std::span<const RivalModel> rivals) {
  std::string names = rivals.front().name;
  for (std::size_t i = 1; i < rivals.size(); ++i)
    names += fmt::format("{}{}", i + 1 == rivals.size() ? " and " : ", ", rivals[i].name);
  return names;
}

Discrimination design_drive_off(std::span<const RivalModel> rivals, const NoiseLevels& noise,
                                const DiscriminationOptions& options) {
  Discrimination design;
  const auto least_after = [&](double duration_s) {
    const double variance = noise.torque_Nm * noise.torque_Nm * kPeriod_s / duration_s;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t truth = 0; truth < rivals.size(); ++truth)
      for (std::size_t other = 0; other < rivals.size(); ++other) {
        if (other == truth) continue;
        const double nats =
            evidence_nats(rivals[truth], rivals[other], variance + kSteadiest_Nm * kSteadiest_Nm);
        if (nats >= least) continue;
        least = nats;
        design.first = std::min(truth, other);
        design.second = std::max(truth, other);
      }
    return least;
  };
  double duration_s = std::min(kShortest_s, options.longest_off_s);
  while (least_after(duration_s) < options.wanted_nats && duration_s < options.longest_off_s)
    duration_s = std::min(kLonger * duration_s, options.longest_off_s);
  design.expected_evidence_nats = design.evidence_nats = least_after(duration_s);
  design.settles = design.expected_evidence_nats >= options.enough_nats;
  const auto rows = static_cast<std::size_t>(std::ceil(duration_s / kPeriod_s - 1e-9));
  design.name = "drive off";
  design.evidence_per_sample_nats = design.evidence_nats / static_cast<double>(rows);
  design.why = fmt::format(
      "{} would read differently with the drive off: {:.1f} s of torque readings should give {:.0f} nats",
      names_of(rivals), static_cast<double>(rows) * kPeriod_s, design.evidence_nats);
  Run& run = design.trajectory;
  run.name = "settle: drive off";
  for (std::size_t k = 0; k < rows; ++k) run.time_s.push_back(static_cast<double>(k) * kPeriod_s);
  for (std::vector<double>* column :
       {&run.torque_Nm, &run.velocity_rad_s, &run.force_N, &run.position_rad, &run.drive_enabled})
    column->assign(rows, 0.0);
  return design;
}

}  // namespace clampd
