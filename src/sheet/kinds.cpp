#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "clampd/brake/dynamics.hpp"
#include "clampd/sheet/sheet.hpp"
#include "src/sheet/measured_brake.hpp"
#include "src/sheet/response.hpp"

namespace clampd {
namespace {

/// (3): dF/dx where this brake has the force.
std::optional<double> stiffness_N_rad(const BrakeParameters& parameters, const Circumstances& at,
                                      const NominalDrive&) {
  const PaperBrake brake = paper_brake(parameters);
  const std::optional<double> x = position_of_force(brake, at.force_N);
  if (!x) return std::nullopt;
  double ignored[PolynomialStiffness::kParameters];
  return brake.stiffness().evaluate(*x, ignored).slope_N_rad;
}

/// (4): what turns the motor in the clearance.
std::optional<double> drag_Nm(const BrakeParameters& parameters, const Circumstances& at,
                              const NominalDrive&) {
  return paper_brake(parameters).friction().sliding_Nm(0.0, at.speed_rad_s, 1.0);
}

/// N F + Tf applying less N F - Tf releasing.
std::optional<double> hysteresis_Nm(const BrakeParameters& parameters, const Circumstances& at,
                                    const NominalDrive&) {
  return 2.0 * paper_brake(parameters).friction().sliding_Nm(at.force_N, at.speed_rad_s, 1.0);
}

/// (5): what static friction could hold beyond the load's torque.
std::optional<double> holding_margin_Nm(const BrakeParameters& parameters, const Circumstances& at,
                                        const NominalDrive&) {
  return paper_brake(parameters).friction().holding_Nm(at.force_N) -
         parameters.fixed.ratio_m_rad * at.force_N;
}

/// From standstill there: load and static friction.
std::optional<double> least_torque_Nm(const BrakeParameters& parameters, const Circumstances& at,
                                      const NominalDrive&) {
  return paper_brake(parameters).friction().holding_Nm(at.force_N) +
         parameters.fixed.ratio_m_rad * at.force_N;
}

/// Between the open position and that of the set point, up to a share of its force. `position_of`: where a
/// brake has a force; `time_of`: how long it takes for a move.
template <class PositionOf, class TimeOf>
std::optional<double> time_between_s(const Circumstances& at, bool applies, const PositionOf& position_of,
                                     const TimeOf& time_of) {
  const std::optional<double> set_point = position_of(at.force_N);
  if (!set_point) return std::nullopt;
  return time_of(Move{.from_rad = applies ? -at.clearance_rad : *set_point,
                      .to_rad = applies ? *set_point : -at.clearance_rad,
                      .level_rad = position_of(at.share * at.force_N).value(),
                      .torque_limit_Nm = at.torque_limit_Nm,
                      .speed_limit_rad_s = at.speed_limit_rad_s});
}

std::optional<double> time_s(const BrakeParameters& parameters, const Circumstances& at,
                             const NominalDrive& drive, bool applies) {
  const PaperBrake brake = paper_brake(parameters);
  return time_between_s(
      at, applies, [&](double force_N) { return position_of_force(brake, force_N); },
      [&](const Move& move) { return move_time_s(brake, move, drive); });
}

std::optional<double> apply_time_s(const BrakeParameters& parameters, const Circumstances& at,
                                   const NominalDrive& drive) {
  return time_s(parameters, at, drive, true);
}

std::optional<double> release_time_s(const BrakeParameters& parameters, const Circumstances& at,
                                     const NominalDrive& drive) {
  return time_s(parameters, at, drive, false);
}

// The same on the test bench, for brakes with effects.

/// What `figure` makes of the place where the brake has the force; nothing if it never has.
template <class Figure>
std::optional<double> at_force(const MeasuredBrake& brake, const Circumstances& at, const Figure& figure) {
  const std::optional<double> x = brake.position_of_force(at.force_N);
  if (!x) return std::nullopt;
  return figure(*x);
}

std::optional<double> measured_stiffness(const MeasuredBrake& brake, const Circumstances& at,
                                         const NominalDrive&) {
  return at_force(brake, at, [&](double x) { return brake.slope_N_rad(x); });
}

std::optional<double> measured_drag(const MeasuredBrake& brake, const Circumstances& at,
                                    const NominalDrive&) {
  constexpr double kInTheClearance_rad = -1.0;
  return brake.torque_Nm(kInTheClearance_rad, at.speed_rad_s);
}

std::optional<double> measured_hysteresis(const MeasuredBrake& brake, const Circumstances& at,
                                          const NominalDrive&) {
  return at_force(brake, at, [&](double x) {
    return brake.torque_Nm(x, at.speed_rad_s) - brake.torque_Nm(x, -at.speed_rad_s);
  });
}

std::optional<double> measured_holding_margin(const MeasuredBrake& brake, const Circumstances& at,
                                              const NominalDrive&) {
  return at_force(brake, at, [&](double x) { return -brake.breakaway_Nm(x, -1.0); });
}

std::optional<double> measured_least_torque(const MeasuredBrake& brake, const Circumstances& at,
                                            const NominalDrive&) {
  return at_force(brake, at, [&](double x) { return brake.breakaway_Nm(x, 1.0); });
}

std::optional<double> measured_time(const MeasuredBrake& brake, const Circumstances& at,
                                    const NominalDrive& drive, bool applies) {
  return time_between_s(
      at, applies, [&](double force_N) { return brake.position_of_force(force_N); },
      [&](const Move& move) { return brake.move_time_s(move, drive); });
}

std::optional<double> measured_apply_time(const MeasuredBrake& brake, const Circumstances& at,
                                          const NominalDrive& drive) {
  return measured_time(brake, at, drive, true);
}

std::optional<double> measured_release_time(const MeasuredBrake& brake, const Circumstances& at,
                                            const NominalDrive& drive) {
  return measured_time(brake, at, drive, false);
}

// Forces end where the loop's own limit of 29 kN would hold it back; shares where the law's approach to its
// target is still a motion and no creeping.
constexpr CircumstanceInfo kForce{"force_N", &Circumstances::force_N, 500.0, 27e3, true};
constexpr CircumstanceInfo kSpeed{"speed_rad_s", &Circumstances::speed_rad_s, 0.1, 300.0, true};
constexpr CircumstanceInfo kApplied{"share", &Circumstances::share, 0.05, 0.95, true};
constexpr CircumstanceInfo kReleased{"share", &Circumstances::share, 0.0, 0.95, true};
constexpr CircumstanceInfo kStart{"clearance_rad", &Circumstances::clearance_rad, 0.0, 25.0, true};
constexpr CircumstanceInfo kOpen{"clearance_rad", &Circumstances::clearance_rad, 0.5, 25.0, true};
constexpr CircumstanceInfo kTorqueLimit{"torque_limit_Nm", &Circumstances::torque_limit_Nm, 0.5, 3.0, false};
constexpr CircumstanceInfo kSpeedLimit{"speed_limit_rad_s", &Circumstances::speed_limit_rad_s, 20.0, 270.0,
                                       false};

}  // namespace

std::span<const CharacteristicKind> characteristic_kinds() {
  static const std::vector<CharacteristicKind> kKinds{
      {"apply-time",
       "s",
       "from the command until the force reaches a share of its set point",
       {kForce, kApplied, kStart, kTorqueLimit, kSpeedLimit},
       {k1, k2, TC, Ts0, Tv, mus, ws},
       1e-3,
       3.0,
       apply_time_s,
       false,
       measured_apply_time},
      {"release-time",
       "s",
       "from the command until the force has fallen to a share of its set point",
       {kForce, kReleased, kOpen, kTorqueLimit, kSpeedLimit},
       {k1, k2, TC, Ts0, Tv, mus, ws},
       1e-3,
       3.0,
       release_time_s,
       false,
       measured_release_time},
      {"drag",
       "N m",
       "torque that turns the motor in the clearance",
       {kSpeed},
       {TC, Ts0, Tv, ws},
       0.0,
       3.0,
       drag_Nm,
       false,
       measured_drag},
      {"hysteresis",
       "N m",
       "torque when applying less that when releasing, at one force and speed",
       {kForce, kSpeed},
       {TC, Ts0, Tv, mus, ws},
       0.0,
       6.0,
       hysteresis_Nm,
       false,
       measured_hysteresis},
      {"holding-margin",
       "N m",
       "static friction less the load's torque, without current",
       {kForce},
       {Ts0, mus},
       -3.0,
       3.0,
       holding_margin_Nm,
       false,
       measured_holding_margin},
      {"least-torque",
       "N m",
       "torque that reaches the force from standstill",
       {kForce},
       {Ts0, mus},
       0.0,
       3.0,
       least_torque_Nm,
       false,
       measured_least_torque},
      {"stiffness",
       "N/rad",
       "force over motor angle",
       {kForce},
       {k1, k2},
       1.0,
       1e5,
       stiffness_N_rad,
       false,
       measured_stiffness},
      {"contact-point",
       "rad",
       "reading of the motor's encoder at which the pads begin to touch",
       {},
       {k1, k2},
       -1e6,
       1e6,
       nullptr},
      {"clearance",
       "rad",
       "how far from contact the check found the brake",
       {},
       {k1, k2},
       -100.0,
       1000.0,
       nullptr,
       true},
  };
  return kKinds;
}

Result<void> check_countable(std::span<const EffectValues> effects) {
  for (const EffectValues& values : effects) {
    const EffectInfo& info = info_of(*values.effect);
    if (!changes_brake(info)) continue;
    if (info.states > 0 || info.order_scan || info.differs_by_run)
      return failure(
          fmt::format("a sheet cannot count {} ({}): with it a brake's figures depend on {}, which no line "
                      "of a sheet says",
                      info.name, info.cause,
                      info.states > 0   ? "what it did before"
                      : info.order_scan ? "where its motor stands"
                                        : "how often it was clamped"));
  }
  return {};
}

}  // namespace clampd
