#include "clampd/experiment/manoeuvres.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "clampd/base/clock.hpp"
#include "clampd/brake/dynamics.hpp"
#include "clampd/brake/integrator.hpp"

namespace clampd {
namespace {

constexpr double kTorqueLimit_Nm = 3.0;

constexpr std::array kStep = {
    ManoeuvreSegment{.duration_s = 0.24, .force_N = 20e3},
    ManoeuvreSegment{.duration_s = 0.16, .force_N = 20e3},
};
constexpr std::array kApplyRelease = {
    ManoeuvreSegment{.duration_s = 0.3, .force_N = 20e3},
    ManoeuvreSegment{.duration_s = 0.2, .force_N = 20e3},
    ManoeuvreSegment{.duration_s = 0.3},
};
constexpr std::array kSinusoid = {
    ManoeuvreSegment{.duration_s = 0.15, .force_N = 5e3},
    ManoeuvreSegment{.duration_s = 1.0, .force_N = 20e3, .cycles = 4},
    ManoeuvreSegment{.duration_s = 0.2},
};
constexpr std::array kSlowSinusoid = {
    ManoeuvreSegment{.duration_s = 0.15, .force_N = 5e3},
    ManoeuvreSegment{.duration_s = 2.0, .force_N = 20e3, .cycles = 3},
    ManoeuvreSegment{.duration_s = 0.2},
};
constexpr std::array kStaircase = {
    ManoeuvreSegment{.duration_s = 0.15, .force_N = 5e3},
    ManoeuvreSegment{.duration_s = 0.06, .force_N = 5e3},
    ManoeuvreSegment{.duration_s = 0.10, .force_N = 10e3},
    ManoeuvreSegment{.duration_s = 0.06, .force_N = 10e3},
    ManoeuvreSegment{.duration_s = 0.10, .force_N = 15e3},
    ManoeuvreSegment{.duration_s = 0.06, .force_N = 15e3},
    ManoeuvreSegment{.duration_s = 0.10, .force_N = 20e3},
    ManoeuvreSegment{.duration_s = 0.06, .force_N = 20e3},
    ManoeuvreSegment{.duration_s = 0.10, .force_N = 15e3},
    ManoeuvreSegment{.duration_s = 0.06, .force_N = 15e3},
    ManoeuvreSegment{.duration_s = 0.10, .force_N = 10e3},
    ManoeuvreSegment{.duration_s = 0.06, .force_N = 10e3},
    ManoeuvreSegment{.duration_s = 0.10, .force_N = 5e3},
    ManoeuvreSegment{.duration_s = 0.06, .force_N = 5e3},
    ManoeuvreSegment{.duration_s = 0.15},
};
constexpr std::array kClearance = {
    ManoeuvreSegment{.duration_s = 0.20, .opening_rad = 5.0},
    ManoeuvreSegment{.duration_s = 0.10, .opening_rad = 0.5},
    ManoeuvreSegment{.duration_s = 0.10, .opening_rad = 5.0},
    ManoeuvreSegment{.duration_s = 0.20, .opening_rad = 0.5},
    ManoeuvreSegment{.duration_s = 0.40, .opening_rad = 5.0},
    ManoeuvreSegment{.duration_s = 0.40, .opening_rad = 0.5},
};

constexpr std::array<ManoeuvreInfo, 7> kManoeuvres = {{
    {"optimal", "the shipped optimal trajectory", {}},
    {"step", "to 20 kN in 0.24 s, hold", kStep},
    {"apply-release", "to 20 kN, hold, and back, in 0.8 s", kApplyRelease},
    {"sinusoid", "1 s at 4 Hz between 5 and 20 kN", kSinusoid},
    {"slow-sinusoid", "2 s at 1.5 Hz between 5 and 20 kN", kSlowSinusoid},
    {"staircase", "up to 20 kN and down again in steps of 5 kN", kStaircase},
    {"clearance", "both directions at several speeds without force", kClearance},
}};

/// The smallest position from contact that has this force, or NaN where the brake never has it.
double position_of(const PolynomialStiffness& stiffness, double force_N) {
  double low = 0.0, high = 0.0;
  constexpr double kStep_rad = 0.5, kFarthest_rad = 200.0;
  while (stiffness.force_N(high) < force_N) {
    low = high;
    high += kStep_rad;
    if (high > kFarthest_rad) return std::nan("");
  }
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (stiffness.force_N(middle) < force_N ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

int rows_of(const ManoeuvreSegment& segment) {
  return static_cast<int>(std::lround(segment.duration_s / kPeriod_s));
}

/// Positions wanted at each millisecond.
std::vector<double> plan_positions(std::span<const ManoeuvreSegment> segments,
                                   const PolynomialStiffness& stiffness) {
  std::vector<double> positions_rad = {0.0};
  for (const ManoeuvreSegment& segment : segments) {
    const double from_rad = positions_rad.back();
    const double from_N = stiffness.force_N(from_rad);
    const double to_rad =
        segment.force_N > 0.0 ? position_of(stiffness, segment.force_N) : -segment.opening_rad;
    const int rows = rows_of(segment);
    for (int k = 1; k <= rows; ++k) {
      const double s = static_cast<double>(k) / rows;
      if (segment.cycles > 0) {
        const double share = 0.5 - 0.5 * std::cos(2.0 * std::numbers::pi * segment.cycles * s);
        positions_rad.push_back(position_of(stiffness, from_N + share * (segment.force_N - from_N)));
      } else if (segment.swing_rad > 0.0) {
        positions_rad.push_back(from_rad);
      } else {
        positions_rad.push_back(from_rad + (to_rad - from_rad) * s * s * s * (10.0 + s * (-15.0 + 6.0 * s)));
      }
    }
  }
  return positions_rad;
}

/// The torque that, held for one row, brings the brake nearest to a velocity: the velocity reached never
/// falls with it.
double torque_for(const PaperBrake& brake, const BrakeParameters& nominal, const BrakeState& state,
                  double velocity_rad_s) {
  // At rest and to stay there: in the middle of what friction holds.
  if (state[1] == 0.0 && velocity_rad_s == 0.0)
    return nominal.fixed.ratio_m_rad * brake.stiffness().force_N(state[0]);
  double low = -1.01 * kTorqueLimit_Nm, high = 1.01 * kTorqueLimit_Nm;
  for (int i = 0; i < 50; ++i) {
    const double middle = 0.5 * (low + high);
    (advance(brake, state, middle, kPeriod_s)[1] < velocity_rad_s ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

/// To and fro, all torque one way or the other: the most acceleration that it has, all the time. It turns
/// round where braking with all torque ends at the place. The swings differ, so that the reversals come at
/// all instants of a row.
class Shaking {
 public:
  Shaking(const PaperBrake& brake, const BrakeParameters& nominal, const ManoeuvreSegment& segment,
          double from_rad)
      : brake_(brake),
        nominal_(nominal),
        torque_Nm_(segment.torque_Nm),
        swing_rad_(segment.swing_rad),
        from_rad_(from_rad) {}

  /// Of the next row. The last reversal before the end is at the start, and there the brake stays.
  double torque_for_row(const BrakeState& state, int rows_left) {
    ++rows_of_cycle_;
    if (ends_) return std::clamp(torque_for(brake_, nominal_, state, 0.0), -torque_Nm_, torque_Nm_);
    const double all_Nm = push_ * torque_Nm_;
    if (!overshoots(state, all_Nm)) return all_Nm;
    double enough_Nm = -all_Nm, too_much_Nm = all_Nm;
    for (int i = 0; i < 30; ++i) {
      const double middle_Nm = 0.5 * (enough_Nm + too_much_Nm);
      (overshoots(state, middle_Nm) ? too_much_Nm : enough_Nm) = middle_Nm;
    }
    turn(rows_left);
    return enough_Nm;
  }

 private:
  /// Cycles that are left for the next one, which may be a longer one, and to stop after it.
  static constexpr double kSpareCycles = 1.6;
  static constexpr int kMaxStop = 200;
  static constexpr double kVariation = 0.3;  // of the swing
  static constexpr double kGolden = 0.6180339887498949;

  /// Whether the place is passed if this torque acts for one row more and the brake then brakes.
  bool overshoots(const BrakeState& state, double torque_Nm) const {
    BrakeState at = advance(brake_, state, torque_Nm, kPeriod_s);
    for (int rows = 0; rows < kMaxStop && push_ * at[1] > 0.0; ++rows) {
      const BrakeState next = advance(brake_, at, -push_ * torque_Nm_, kPeriod_s);
      const double part = push_ * next[1] > 0.0 ? 1.0 : at[1] / (at[1] - next[1]);
      const double reached_rad = part < 1.0 ? at[0] + 0.5 * part * kPeriod_s * at[1] : next[0];
      if (push_ * (reached_rad - place_rad()) > 0.0) return true;
      at = next;
    }
    return false;
  }
  double place_rad() const {
    return push_ > 0.0 ? from_rad_ : from_rad_ - swing_rad_ * (1.0 - kVariation * variation_);
  }
  void turn(int rows_left) {
    push_ = -push_;
    if (push_ > 0.0) return;
    ends_ = rows_left < kSpareCycles * rows_of_cycle_;
    rows_of_cycle_ = 0;
    variation_ = std::fmod(variation_ + kGolden, 1.0);
  }

  const PaperBrake& brake_;
  const BrakeParameters& nominal_;
  double torque_Nm_, swing_rad_, from_rad_;
  double push_ = -1.0;
  double variation_ = 0.0;
  int rows_of_cycle_ = 0;
  bool ends_ = false;
};

tl::unexpected<Error> still_shaking(std::string_view name) {
  return failure(
      fmt::format("manoeuvre {}: there is no time for its swings; make them smaller or it longer", name));
}

}  // namespace

std::span<const ManoeuvreInfo> manoeuvres() {
  return kManoeuvres;
}

Result<Run> make_manoeuvre(std::string_view name, const BrakeParameters& nominal, const Run& optimal) {
  const auto found = std::find_if(kManoeuvres.begin(), kManoeuvres.end(),
                                  [&](const ManoeuvreInfo& info) { return info.name == name; });
  if (found == kManoeuvres.end()) {
    std::vector<std::string_view> names;
    for (const ManoeuvreInfo& info : kManoeuvres) names.push_back(info.name);
    return failure(fmt::format("unknown manoeuvre '{}'; known are: {}", name, fmt::join(names, ", ")));
  }
  if (found->segments.empty()) return optimal;
  return follow_segments(name, found->segments, nominal);
}

Result<Run> follow_segments(std::string_view name, std::span<const ManoeuvreSegment> segments,
                            const BrakeParameters& nominal) {
  const PaperBrake brake = paper_brake(nominal);
  const std::vector<double> wanted_rad = plan_positions(segments, brake.stiffness());
  if (!std::all_of(wanted_rad.begin(), wanted_rad.end(), [](double x) { return std::isfinite(x); }))
    return failure(fmt::format("manoeuvre {}: the nominal brake cannot reach its forces", name));
  Run run;
  run.name = name;
  BrakeState state = BrakeState::Zero();
  std::optional<Shaking> shaking;
  std::size_t segment = 0, end_of_segment = 0;
  for (std::size_t k = 0; k < wanted_rad.size(); ++k) {
    while (k == end_of_segment && segment < segments.size()) {
      if (shaking && state[1] != 0.0) return still_shaking(name);
      shaking.reset();
      if (segments[segment].swing_rad > 0.0) shaking.emplace(brake, nominal, segments[segment], state[0]);
      end_of_segment += static_cast<std::size_t>(rows_of(segments[segment++]));
    }
    const std::size_t next = std::min(k + 1, wanted_rad.size() - 1);
    const std::size_t after = std::min(k + 2, wanted_rad.size() - 1);
    // Central difference of the plan, and back onto it where the rows have drifted off.
    double velocity_rad_s = 0.5 * (wanted_rad[after] - wanted_rad[k]) / kPeriod_s;
    const bool holds = wanted_rad[k] == wanted_rad[next] && wanted_rad[next] == wanted_rad[after];
    constexpr double kPull_per_s = 100.0;
    if (!holds) velocity_rad_s += kPull_per_s * (wanted_rad[k] - state[0]);
    const double torque_Nm = shaking ? shaking->torque_for_row(state, static_cast<int>(end_of_segment - k))
                                     : torque_for(brake, nominal, state, holds ? 0.0 : velocity_rad_s);
    if (!(std::abs(torque_Nm) <= kTorqueLimit_Nm))
      return failure(fmt::format("manoeuvre {}: at {} ms the nominal brake would need more than {} N m", name,
                                 k, kTorqueLimit_Nm));
    run.time_s.push_back(static_cast<double>(k) * kPeriod_s);
    run.torque_Nm.push_back(torque_Nm);
    run.velocity_rad_s.push_back(state[1]);
    run.force_N.push_back(brake.stiffness().force_N(state[0]));
    run.position_rad.push_back(state[0]);
    state = advance(brake, state, torque_Nm, kPeriod_s);
  }
  if (shaking && state[1] != 0.0) return still_shaking(name);
  return run;
}

}  // namespace clampd
