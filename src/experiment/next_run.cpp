#include "clampd/experiment/next_run.hpp"

#include <utility>

#include "clampd/base/assert.hpp"
#include "clampd/base/nan.hpp"
#include "clampd/identify/expected_covariance.hpp"
#include "closed_loop.hpp"

namespace clampd {

TrajectorySet::TrajectorySet(std::vector<Reference> references, const NominalDrive& drive,
                             double torque_limit_Nm)
    : references_(std::move(references)), drive_(drive), torque_limit_Nm_(torque_limit_Nm) {}

NextRunValue TrajectorySet::value_of_next(const Estimate& joint, std::span<const double> driven) const {
  CLAMPD_ASSERT(driven.size() == size());
  const NoiseLevels noise{{joint.noise_force_N, joint.noise_velocity_rad_s}, joint.noise_torque_Nm};
  const ClosedLoop loop(drive_, torque_limit_Nm_);
  std::vector<ExpectedContribution> contributions;
  std::vector<bool> is_followed;
  TrackedRun run;
  for (const Reference& reference : references_) {
    loop.track(reference, joint.parameters, run);
    is_followed.push_back(run.bounded);
    contributions.push_back(
        expected_contribution(joint.method, joint.parameters, BrakeState::Zero(),
                              Excitation{.torque_Nm = run.torque_Nm, .dt_s = drive_.period_s}, noise));
  }
  NextRunValue value{expected_covariance(contributions, driven), {}};
  for (std::size_t k = 0; k < size(); ++k) {
    std::vector<double> counts(driven.begin(), driven.end());
    counts[k] += 1.0;
    value.after.push_back(is_followed[k] ? expected_covariance(contributions, counts)
                                         : ParameterMatrix::Constant(kNaN));
  }
  return value;
}

}  // namespace clampd
