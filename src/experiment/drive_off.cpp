#include "drive_off.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

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

/// Of one rival, if another one is true: what it takes for a torque then, and how well it could know.
struct Misfit {
  std::size_t truth, other;
  double taken_Nm, own_variance;

  double nats(double reading_variance) const {
    return 0.5 * taken_Nm * taken_Nm / (reading_variance + own_variance);
  }
};

Misfit misfit_of(std::span<const RivalModel> rivals, std::size_t of_truth, std::size_t of_other) {
  const RivalModel& truth = rivals[of_truth];
  const RivalModel& other = rivals[of_other];
  const ExtendedBrake brake(truth.parameters);
  const double at_zero_Nm = brake.acting_torque(0.0);
  const double slope = brake.acting_torque(1.0) - at_zero_Nm;
  const double reading_Nm = -at_zero_Nm / slope;
  const ExtendedBrake judge(other.parameters);
  Eigen::VectorXd gradient(judge.parameters());
  const double taken_Nm = judge.acting_torque(reading_Nm, gradient.data());
  return {of_truth, of_other, taken_Nm, own_variance(other, gradient)};
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
  std::vector<Misfit> misfits;
  for (std::size_t truth = 0; truth < rivals.size(); ++truth)
    for (std::size_t other = 0; other < rivals.size(); ++other)
      if (other != truth) misfits.push_back(misfit_of(rivals, truth, other));
  Discrimination design;
  const auto least_after = [&](double duration_s) {
    const double variance =
        noise.torque_Nm * noise.torque_Nm * kPeriod_s / duration_s + kSteadiest_Nm * kSteadiest_Nm;
    const Misfit& least =
        *std::ranges::min_element(misfits, {}, [&](const Misfit& misfit) { return misfit.nats(variance); });
    design.first = std::min(least.truth, least.other);
    design.second = std::max(least.truth, least.other);
    return least.nats(variance);
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
