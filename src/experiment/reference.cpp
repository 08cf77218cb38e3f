#include "clampd/experiment/reference.hpp"

#include <cmath>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <Eigen/Dense>

#include "clampd/base/clock.hpp"
#include "clampd/brake/dynamics.hpp"
#include "clampd/brake/integrator.hpp"

namespace clampd {
namespace {

constexpr std::size_t kMaxRows = 100'000;

Result<void> check_shape(const Run& run) {
  if (run.size() < 2 || run.size() > kMaxRows)
    return failure(fmt::format("{}: a trajectory has 2 to {} rows, not {}", run.name, kMaxRows, run.size()));
  if (!is_driven(run))
    return failure(
        fmt::format("{}: the drive is off in all rows: that can be recorded, not tracked", run.name));
  const auto full = [&](const std::vector<double>& column) { return column.size() == run.size(); };
  if (!full(run.torque_Nm) || !full(run.velocity_rad_s) || !full(run.force_N) || !full(run.position_rad))
    return failure(fmt::format(
        "{}: a trajectory needs torque_Nm, velocity_rad_s, force_N and position_rad in every row", run.name));
  for (std::size_t k = 0; k < run.size(); ++k) {
    const double due_s = run.time_s[0] + static_cast<double>(k) * kPeriod_s;
    if (!(std::abs(run.time_s[k] - due_s) <= 1e-6))
      return failure(
          fmt::format("{}: row {} is at {} s, but rows must be 1 ms apart", run.name, k, run.time_s[k]));
  }
  return {};
}

Result<void> check_limits(const Run& run, const ReferenceOptions& options) {
  const auto within = [&](std::string_view column, double value, double limit,
                          std::size_t k) -> Result<void> {
    if (std::abs(value) <= limit) return {};
    return failure(fmt::format("{}: row {}: {} = {:.6g} is beyond the limit of {:.6g}", run.name, k, column,
                               value, limit));
  };
  for (std::size_t k = 0; k < run.size(); ++k) {
    auto checked = within("torque_Nm", run.torque_Nm[k], options.torque_limit_Nm, k);
    if (checked) checked = within("velocity_rad_s", run.velocity_rad_s[k], options.velocity_limit_rad_s, k);
    if (checked) checked = within("force_N", run.force_N[k], options.force_limit_N, k);
    if (!checked) return checked;
  }
  if (std::abs(run.velocity_rad_s[0]) > options.consistency_velocity_rad_s ||
      std::abs(run.force_N[0]) > options.start_force_limit_N)
    return failure(
        fmt::format("{}: a trajectory starts at rest and without force, not at {:.6g} rad/s and {:.6g} N",
                    run.name, run.velocity_rad_s[0], run.force_N[0]));
  return {};
}

Result<void> check_consistency(const Run& run, const PaperBrake& brake, const ReferenceOptions& options) {
  for (std::size_t k = 0; k < run.size(); ++k) {
    const double force_N = brake.stiffness().force_N(run.position_rad[k]);
    if (!(std::abs(force_N - run.force_N[k]) <= options.consistency_force_N))
      return failure(fmt::format(
          "{}: row {}: force_N = {:.6g}, but the nominal brake has {:.6g} N at {:.6g} rad; was the "
          "trajectory designed for another brake?",
          run.name, k, run.force_N[k], force_N, run.position_rad[k]));
    if (k + 1 == run.size()) break;
    const BrakeState next =
        advance(brake, BrakeState(run.position_rad[k], run.velocity_rad_s[k]), run.torque_Nm[k], kPeriod_s);
    const double position_error = run.position_rad[k + 1] - next[0];
    const double velocity_error = run.velocity_rad_s[k + 1] - next[1];
    if (!(std::abs(position_error) <= options.consistency_position_rad) ||
        !(std::abs(velocity_error) <= options.consistency_velocity_rad_s))
      return failure(
          fmt::format("{}: row {} does not follow from row {}: the nominal brake would be {:.3g} rad and "
                      "{:.3g} rad/s elsewhere; was the trajectory designed for another brake?",
                      run.name, k + 1, k, position_error, velocity_error));
  }
  return {};
}

/// Rows of the trajectory in one of the loop's periods, whose torque has to be one.
Result<std::size_t> rows_per_period(const Run& run, double period_s) {
  const auto rows = static_cast<std::size_t>(std::lround(period_s / kPeriod_s));
  for (std::size_t k = 0; k < run.size(); ++k)
    if (run.torque_Nm[k] != run.torque_Nm[k - k % rows])
      return failure(fmt::format(
          "{}: row {}: the torque changes within the station's period of {:g} ms, so that it cannot be "
          "replayed; "
          "design a trajectory whose torque is held for a multiple of it (`clampctl design --block {}`)",
          run.name, k, 1e3 * period_s, 2 * rows));
  return rows;
}

/// Backward Riccati recursion along the rows; from its stationary solution at the last row.
void add_gains(std::vector<ReferenceRow>& rows, const PaperBrake& brake, const BrakeParameters& nominal,
               const ReferenceOptions& options) {
  const double period_s = options.period_s;
  const double input_cost = 1.0 / (options.tracking_torque_Nm * options.tracking_torque_Nm);
  const Eigen::Vector2d input(0.5 * period_s * period_s / nominal.fixed.inertia_kg_m2,
                              period_s / nominal.fixed.inertia_kg_m2);
  Eigen::Matrix2d cost_to_go = Eigen::Matrix2d::Zero();
  const auto back_up = [&](ReferenceRow& row) {
    const double sign = row.velocity_rad_s < 0.0 ? -1.0 : 1.0;
    const auto slope = brake.linearise(row.position_rad, row.velocity_rad_s, row.torque_Nm, sign);
    Eigen::Matrix2d transition;
    transition << 1.0, period_s, period_s * slope.by_position, 1.0 + period_s * slope.by_velocity;
    Eigen::Matrix2d cost = Eigen::Matrix2d::Zero();
    cost(0, 0) = std::pow(row.stiffness_N_rad / options.tracking_force_N, 2) +
                 std::pow(1.0 / options.tracking_position_rad, 2);
    cost(1, 1) = std::pow(1.0 / options.tracking_velocity_rad_s, 2);
    const Eigen::RowVector2d gain =
        (input.transpose() * cost_to_go * transition) / (input_cost + input.dot(cost_to_go * input));
    const Eigen::Matrix2d closed = transition - input * gain;
    cost_to_go =
        (cost + input_cost * gain.transpose() * gain + closed.transpose() * cost_to_go * closed).eval();
    row.gain_position = gain[0];
    row.gain_velocity = gain[1];
  };
  for (int iteration = 0; iteration < 500; ++iteration) back_up(rows.back());
  for (std::size_t k = rows.size(); k-- > 0;) back_up(rows[k]);
}

}  // namespace

Result<void> ReferenceOptions::validate() const {
  const std::pair<std::string_view, double> values[] = {
      {"period_s", period_s},
      {"force_limit_N", force_limit_N},
      {"velocity_limit_rad_s", velocity_limit_rad_s},
      {"torque_limit_Nm", torque_limit_Nm},
      {"start_force_limit_N", start_force_limit_N},
      {"consistency_position_rad", consistency_position_rad},
      {"consistency_velocity_rad_s", consistency_velocity_rad_s},
      {"consistency_force_N", consistency_force_N},
      {"tracking_force_N", tracking_force_N},
      {"tracking_position_rad", tracking_position_rad},
      {"tracking_velocity_rad_s", tracking_velocity_rad_s},
      {"tracking_torque_Nm", tracking_torque_Nm},
  };
  for (const auto& [name, value] : values)
    if (!std::isfinite(value) || !(value > 0.0))
      return failure(fmt::format("reference: {} = {} must be positive and finite", name, value));
  return {};
}

NominalDrive nominal_drive(const BrakeParameters& nominal, double period_s) {
  NominalDrive drive;
  drive.period_s = period_s;
  drive.inertia_kg_m2 = nominal.fixed.inertia_kg_m2;
  drive.ratio_m_rad = nominal.fixed.ratio_m_rad;
  drive.cubic_N_rad3 = nominal.theta[k1];
  drive.quadratic_N_rad2 = nominal.theta[k2];
  drive.coulomb_Nm = nominal.theta[TC];
  drive.static_Nm = nominal.theta[Ts0];
  drive.viscous_Nm_s_rad = nominal.theta[Tv];
  drive.load_friction_Nm_N = nominal.theta[mus];
  drive.stribeck_rad_s = nominal.theta[ws];
  return drive;
}

Result<Reference> build_reference(const Run& trajectory, const BrakeParameters& nominal,
                                  const ReferenceOptions& options) {
  const PaperBrake brake = paper_brake(nominal);
  Result<void> checked = options.validate();
  if (checked) checked = check_shape(trajectory);
  if (checked) checked = check_limits(trajectory, options);
  if (checked) checked = check_consistency(trajectory, brake, options);
  if (!checked) return tl::unexpected(checked.error());
  const Result<std::size_t> per_period = rows_per_period(trajectory, options.period_s);
  if (!per_period) return tl::unexpected(per_period.error());

  Reference reference;
  for (std::size_t k = 0; k < trajectory.size(); k += *per_period) {
    ReferenceRow& row = reference.rows.emplace_back();
    row.force_N = trajectory.force_N[k];
    row.position_rad = trajectory.position_rad[k];
    row.velocity_rad_s = trajectory.velocity_rad_s[k];
    row.torque_Nm = trajectory.torque_Nm[k];
    double gradient[PolynomialStiffness::kParameters];
    row.stiffness_N_rad = brake.stiffness().evaluate(row.position_rad, gradient).slope_N_rad;
  }
  add_gains(reference.rows, brake, nominal, options);
  return reference;
}

}  // namespace clampd
