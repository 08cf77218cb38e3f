#include "src/drive/terms.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

namespace clampd::drive {
namespace {

using Carrier = BasisFunction::Carrier;
using Factor = BasisFunction::Factor;

std::vector<double> geometric(double from, double to, int count) {
  std::vector<double> values;
  for (int k = 0; k < count; ++k) values.push_back(from * std::pow(to / from, k / (count - 1.0)));
  return values;
}

struct Builder {
  DriveTerm term;
  std::string name;
  std::vector<Variant> variants = {};

  Variant& add(std::vector<BasisFunction> functions) {
    variants.push_back({term, name, std::move(functions)});
    return variants.back();
  }
  std::vector<Variant> done() {
    for (Variant& each : variants) each.alternatives = static_cast<double>(variants.size());
    return std::move(variants);
  }
};

std::vector<Variant> friction_powers(Builder builder, const DriveRange& range) {
  for (const double power : {0.15, 0.3, 0.45, 0.6, 0.75, 0.85, 1.2, 1.6, 2.5, 3.0}) {
    const BasisFunction common{Carrier::Direction, Factor::Power, range.fast, power};
    const BasisFunction differs{Carrier::Sliding, Factor::Power, range.fast, power};
    builder.add({common}).replaces_viscous = true;
    builder.add({common});
    if (range.both_directions()) builder.add({common, differs}).replaces_viscous = true;
  }
  return builder.done();
}

std::vector<Variant> friction_shapes(Builder builder, const DriveRange& range) {
  for (const double speed : geometric(0.01 * range.fast, 0.7 * range.fast, 10))
    for (const double exponent : {1.0, 2.0}) {
      const BasisFunction common{Carrier::Direction, Factor::Stribeck, speed, exponent};
      builder.add({common});
      if (range.both_directions())
        builder.add({common, {Carrier::Sliding, Factor::Stribeck, speed, exponent}});
    }
  return builder.done();
}

std::vector<Variant> gravities(Builder builder, const DriveRange& range, const DriveData& data) {
  const double travel = range.highest - range.lowest;
  std::vector<double> multiples{1.0};
  // A gear's output that turns by a quarter of a turn to three.
  for (double multiple = 1.5 / travel; multiple < 20.0 / travel; multiple += 0.6 / travel)
    if (multiple < 0.9 || multiple > 1.1) multiples.push_back(multiple);
  for (const double multiple : multiples) {
    if (multiple > 1.0 || (multiple == 1.0 && travel < 0.5)) continue;
    std::vector<BasisFunction> functions;
    const int owners = data.position_absolute ? 1 : range.runs;
    for (int owner = 0; owner < owners; ++owner)
      for (const Factor factor : {Factor::Sine, Factor::Cosine})
        functions.push_back({Carrier::One, factor, multiple, 1.0, data.position_absolute ? -1 : owner});
    builder.add(functions);
  }
  std::vector<Variant> variants = builder.done();
  // The drive's own angle is what one expects: the others have to pay for their choice.
  if (!variants.empty() && variants.front().functions.front().first == 1.0)
    variants.front().alternatives = 2.0;
  return variants;
}

std::vector<Variant> drifts(Builder builder, const DriveRange& range) {
  const BasisFunction within{Carrier::Direction, Factor::Time, 0.5 * range.duration_s, range.duration_s};
  const BasisFunction per_run{Carrier::Direction, Factor::Run, 0.5 * (range.runs - 1)};
  BasisFunction viscous_within = within, viscous_per_run = per_run;
  viscous_within.carrier = viscous_per_run.carrier = Carrier::Velocity;
  builder.add({within});
  builder.add({viscous_within});
  // Nothing warms up within seconds.
  if (range.duration_s > 10.0)
    for (const double share : {0.05, 0.1, 0.2, 0.4, 0.8}) {
      const BasisFunction dry{Carrier::Direction, Factor::TimeDecay, share * range.duration_s};
      BasisFunction viscous = dry;
      viscous.carrier = Carrier::Velocity;
      builder.add({dry});
      builder.add({dry, viscous});
    }
  constexpr int kMostRuns = 12;
  if (range.runs > 2 && range.runs <= kMostRuns) {  // each as it likes
    std::vector<BasisFunction> dry, both;
    for (int run = 1; run < range.runs; ++run) {
      dry.push_back({Carrier::Direction, Factor::InRun, static_cast<double>(run)});
      both.push_back(dry.back());
      both.push_back({Carrier::Velocity, Factor::InRun, static_cast<double>(run)});
    }
    builder.add(dry);
    builder.add(both);
  }
  if (range.runs > 1) {
    builder.add({per_run});
    builder.add({viscous_per_run});
    builder.add({per_run, viscous_per_run});
    builder.add({within, per_run});
  }
  return builder.done();
}

std::vector<Variant> regressors(const DriveData& data, const DriveModel& model) {
  std::vector<Variant> all;
  for (std::size_t c = 0; c < model.regressors.size(); ++c) {
    if (model.regressors[c].known_torque || model.regressors[c].use == PartUse::Off) continue;
    if (is_constant(data, c)) continue;
    double sum = 0.0, count = 0.0;
    for (const DriveRows& run : data.runs)
      for (const double value : run.motion.columns[c]) sum += value, count += 1.0;
    Builder builder{DriveTerm::Regressor, "column:" + model.regressors[c].name};
    const int index = static_cast<int>(c);
    const double mean = sum / std::max(1.0, count);
    builder.add({{Carrier::One, Factor::Column, 0.0, 1.0, index}});
    builder.add({{Carrier::One, Factor::Column, mean, 1.0, index},
                 {Carrier::One}});  // a sensor whose zero is unknown
    builder.add({{Carrier::Direction, Factor::Column, mean, 1.0, index}});
    builder.add({{Carrier::Velocity, Factor::Column, mean, 1.0, index}});
    if (model.regressors[c].per_file)  // a payload
      builder.add({{Carrier::Acceleration, Factor::Column, mean, 1.0, index}});
    for (Variant& each : builder.done()) all.push_back(std::move(each));
  }
  return all;
}

/// Squared correlation of position and acceleration, about each run's means.
double sinusoidal(const DriveData& data) {
  double product = 0.0, position = 0.0, acceleration = 0.0;
  for (const DriveRows& run : data.runs) {
    if (run.heldout) continue;
    const Eigen::VectorXd place = run.position.array() - run.position.mean();
    const Eigen::VectorXd change = run.acceleration.array() - run.acceleration.mean();
    product += place.dot(change);
    position += place.squaredNorm();
    acceleration += change.squaredNorm();
  }
  return position > 0.0 && acceleration > 0.0 ? product * product / (position * acceleration) : 0.0;
}

}  // namespace

bool is_constant(const DriveData& data, std::size_t regressor) {
  constexpr double kRounding = 1e-9;
  double lowest = std::numeric_limits<double>::infinity(), highest = -lowest;
  for (const DriveRows& run : data.runs) {
    if (run.heldout) continue;
    for (const double value : run.motion.columns[regressor]) {
      lowest = std::min(lowest, value);
      highest = std::max(highest, value);
    }
  }
  return highest - lowest <= kRounding * std::max(std::abs(lowest), std::abs(highest));
}

DriveRange range_of(const DriveData& data) {
  DriveRange range;
  range.lowest = std::numeric_limits<double>::infinity();
  range.highest = -range.lowest;
  std::vector<double> speeds;
  double acceleration = 0.0, torque = 0.0, forward = 0.0;
  for (const DriveRows& run : data.runs) {
    if (run.heldout) continue;
    range.lowest = std::min(range.lowest, run.position.minCoeff());
    range.highest = std::max(range.highest, run.position.maxCoeff());
    range.duration_s = std::max(range.duration_s, run.motion.time_s.back());
    range.runs = std::max(range.runs, run.run + 1);
    for (Eigen::Index i = 0; i < run.velocity.size(); ++i) {
      speeds.push_back(std::abs(run.velocity[i]));
      acceleration += run.acceleration[i] * run.acceleration[i];
      torque += run.torque[i] * run.torque[i];
      range.most_torque = std::max(range.most_torque, std::abs(run.torque[i]));
      if (run.velocity[i] > 0.0) forward += 1.0;
      if (i > 0 && run.velocity[i] * run.velocity[i - 1] < 0.0) ++range.reversals;
    }
  }
  std::sort(speeds.begin(), speeds.end());
  const auto count = static_cast<double>(speeds.size());
  range.slow = speeds[static_cast<std::size_t>(0.05 * (count - 1.0))];
  range.fast = speeds[static_cast<std::size_t>(0.98 * (count - 1.0))];
  range.acceleration = std::sqrt(acceleration / count);
  range.torque = std::sqrt(torque / count);
  range.sinusoidal = sinusoidal(data);
  range.forward = forward / count;
  return range;
}

std::vector<Variant> variants_of(DriveTerm term, const DriveRange& range, const DriveData& data,
                                 const DriveModel& model) {
  Builder builder{term, std::string(name_of(term))};
  const BasisFunction slope{Carrier::One, Factor::Place, 0.0, std::max(range.half(), 1e-300)};
  const BasisFunction place{Carrier::Direction, Factor::Place, range.centre(),
                            std::max(range.half(), 1e-300)};
  const BasisFunction cubic{Carrier::One, Factor::PlaceCubed, 0.0, std::max(range.half(), 1e-300)};
  BasisFunction curvature = place, square = slope;
  curvature.factor = square.factor = Factor::PlaceSquared;
  switch (term) {
    case DriveTerm::Inertia:
      builder.add({{Carrier::Acceleration}});
      break;
    case DriveTerm::Viscous:
      builder.add({{Carrier::Velocity}});
      break;
    case DriveTerm::Coulomb:
      builder.add({{Carrier::Direction}});
      break;
    case DriveTerm::TorqueOffset:
      builder.add({{Carrier::One}});
      break;
    case DriveTerm::FrictionAsymmetry:
      builder.add({{Carrier::Sliding, Factor::Power, 1.0, 1.0}});
      builder.add({{Carrier::Sliding}, {Carrier::Sliding, Factor::Power, 1.0, 1.0}});
      builder.add({{Carrier::Sliding}});
      break;
    case DriveTerm::QuadraticDrag:
      builder.add({{Carrier::Velocity, Factor::Power, 1.0, 1.0}});
      break;
    case DriveTerm::FrictionShape:
      return friction_shapes(builder, range);
    case DriveTerm::Presliding:
      for (const double length : geometric(2e-4 * 2.0 * range.half(), 0.1 * 2.0 * range.half(), 12)) {
        const BasisFunction spring{Carrier::Direction, Factor::Reversal, length};
        BasisFunction damping = spring;
        damping.carrier = Carrier::Velocity;
        builder.add({spring});
        builder.add({spring, damping});
      }
      break;
    case DriveTerm::FrictionPosition:
      builder.add({place});
      builder.add({place, curvature});
      if (!model.linear && range.half() > 1.2 * M_PI)
        builder.add({{Carrier::Direction, Factor::Sine, 1.0}, {Carrier::Direction, Factor::Cosine, 1.0}});
      break;
    case DriveTerm::LoadPosition:
      builder.add({slope});
      builder.add({slope, {Carrier::One}});
      builder.add({slope, cubic});
      builder.add({slope, {Carrier::One}, cubic});
      builder.add({slope, {Carrier::One}, cubic, square});  // about a place of its own
      break;
    case DriveTerm::InertiaPosition: {
      BasisFunction mass = place, mass_curvature = curvature;
      mass.carrier = mass_curvature.carrier = Carrier::Acceleration;
      builder.add({mass});
      builder.add({mass, mass_curvature});
      break;
    }
    case DriveTerm::FrictionDrift:
      return drifts(builder, range);
    case DriveTerm::Gravity:
      return gravities(builder, range, data);
    case DriveTerm::FrictionPower:
      return friction_powers(builder, range);
    case DriveTerm::LoadFriction:
      for (std::size_t c = 0; c < model.regressors.size(); ++c)
        builder.add({{Carrier::Direction, Factor::ColumnSize, 0.0, 1.0, static_cast<int>(c)}});
      break;
    case DriveTerm::Regressor:
      return regressors(data, model);
    case DriveTerm::TorqueLag: {
      if (!(data.cut_off_Hz > 0.0)) break;
      const double unit_s = 1.0 / data.cut_off_Hz;
      const double longest_s = 0.1 * range.duration_s;
      std::vector<double> lags;
      for (int k = 1; k <= 15; ++k) lags.push_back(0.02 * k * unit_s);
      for (int k = 1; k <= 18; ++k) lags.push_back((0.3 + 0.07 * k) * unit_s);
      for (const double lag_s : lags)
        if (lag_s < longest_s)
          for (const double side : {1.0, -1.0}) builder.add({}).lag_s = side * lag_s;
      // Beyond these, what the readings themselves show.
      if (std::abs(data.delay_s) > lags.back())
        for (int k = -6; k <= 6; ++k) builder.add({}).lag_s = data.delay_s + 0.07 * k * unit_s;
      for (const double settling_s : geometric(0.02 * unit_s, 2.0 * unit_s, 14))
        if (settling_s < longest_s) builder.add({}).settling_s = settling_s;
      break;
    }
    case DriveTerm::TorqueSaturation:
      for (const double exponent : {2.0, 3.0, 5.0})
        for (const double loss : {0.03, 0.06, 0.1, 0.15, 0.2, 0.3})
          builder.add({{Carrier::One, Factor::BalancePower, range.most_torque, exponent}}).saturation = loss;
      break;
    case DriveTerm::Cogging:
      break;  // of the residuals
  }
  return builder.done();
}

std::optional<Unidentifiable> unidentifiable(DriveTerm term, const DriveRange& range, const DriveData& data,
                                             const DriveModel& model) {
  constexpr double kPureSinusoid = 0.998;
  const bool one_speed = range.fast < 1.5 * range.slow;
  const Unidentifiable directions{"the runs go in one direction only",
                                  "the same motion forward and backward"};
  const Unidentifiable speeds{"the runs go at about one speed",
                              fmt::format("speeds from {:.2g} to {:.2g} {}/s, in both directions",
                                          0.2 * range.fast, range.fast, model.position_unit())};
  const Unidentifiable places{
      "the position is integrated from the velocity, so that no place is the same in two runs",
      "the same runs with a position reading"};
  const bool no_place = !data.position_absolute && range.runs > 1;
  switch (term) {
    case DriveTerm::TorqueOffset:
    case DriveTerm::FrictionAsymmetry:
      if (!range.both_directions()) return directions;
      break;
    case DriveTerm::QuadraticDrag:
    case DriveTerm::FrictionPower:
    case DriveTerm::FrictionShape:
      if (one_speed) return speeds;
      break;
    case DriveTerm::Presliding:
      if (model.steady || range.reversals < 3)
        return Unidentifiable{"the drive hardly reverses while it is recorded",
                              "slow reversals, ten or more, all over the range"};
      break;
    case DriveTerm::FrictionPosition:
    case DriveTerm::LoadPosition:
      if (model.steady)
        return Unidentifiable{"a run at steady speed counts as one point without a place", "runs to and fro"};
      if (no_place) return places;
      if (term == DriveTerm::LoadPosition && !range.both_directions()) return directions;
      if (term == DriveTerm::LoadPosition && range.sinusoidal > kPureSinusoid)
        return Unidentifiable{"the motion is one sinusoid, in which a spring and the inertia are the same",
                              "the same motion at half the frequency as well"};
      break;
    case DriveTerm::InertiaPosition:
      if (model.steady || !(range.acceleration > 0.0))
        return Unidentifiable{"the drive hardly accelerates", "accelerations all over the range"};
      if (no_place) return places;
      break;
    case DriveTerm::Gravity:
      if (model.linear) return Unidentifiable{"on a linear axis gravity is a constant: torque-offset", ""};
      if (model.steady)
        return Unidentifiable{"a run at steady speed counts as one point without a place", "runs to and fro"};
      if (range.highest - range.lowest < 0.5)
        return Unidentifiable{fmt::format("the drive turns by {:.2g} rad only", range.highest - range.lowest),
                              "half a turn or more"};
      break;
    case DriveTerm::FrictionDrift:
      if (model.steady && range.runs < 8) return Unidentifiable{"too few runs", "more runs"};
      break;
    case DriveTerm::TorqueLag:
      if (model.steady)
        return Unidentifiable{"at steady speed nothing changes that could be late", "accelerations"};
      break;
    default:
      break;
  }
  return std::nullopt;
}

int complexity(const Variant& variant) {
  if (changes_torque(variant)) return 1;
  return static_cast<int>(variant.functions.size()) - (variant.replaces_viscous ? 1 : 0) +
         (free_shape(variant) != nullptr ? 1 : 0);
}

const double* free_shape(const Variant& variant) {
  if (variant.functions.empty()) {
    if (variant.term != DriveTerm::TorqueLag) return nullptr;
    return variant.settling_s > 0.0 ? &variant.settling_s : &variant.lag_s;
  }
  if (variant.saturation > 0.0) return &variant.saturation;
  const BasisFunction& function = variant.functions.front();
  switch (variant.term) {
    case DriveTerm::FrictionShape:
    case DriveTerm::Presliding:
      return &function.first;
    case DriveTerm::FrictionPower:
      return &function.second;
    case DriveTerm::Gravity:
    case DriveTerm::FrictionPosition:
    case DriveTerm::InertiaPosition:
      return function.factor != Factor::Sine || function.first == 1.0 ? nullptr : &function.first;
    case DriveTerm::FrictionDrift:
      return function.factor == Factor::TimeDecay ? &function.first : nullptr;
    default:
      return nullptr;
  }
}

Variant with_shape(const Variant& variant, double shape) {
  Variant result = variant;
  result.columns.clear();
  if (variant.saturation > 0.0) {
    result.saturation = shape;
    return result;
  }
  if (variant.term == DriveTerm::TorqueLag)
    (variant.settling_s > 0.0 ? result.settling_s : result.lag_s) = shape;
  for (BasisFunction& function : result.functions)
    (variant.term == DriveTerm::FrictionPower ? function.second : function.first) = shape;
  return result;
}

namespace {

bool rubs(DriveTerm term) {
  constexpr std::array kFriction{DriveTerm::Viscous,           DriveTerm::Coulomb,
                                 DriveTerm::FrictionAsymmetry, DriveTerm::QuadraticDrag,
                                 DriveTerm::FrictionShape,     DriveTerm::FrictionPosition,
                                 DriveTerm::FrictionDrift,     DriveTerm::FrictionPower};
  return std::ranges::find(kFriction, term) != kFriction.end();
}

const FittedTerm* term_of(const std::vector<FittedTerm>& terms, DriveTerm wanted) {
  for (const FittedTerm& term : terms)
    if (term.term == wanted) return &term;
  return nullptr;
}

std::optional<std::string> impossible_friction(const std::vector<FittedTerm>& terms, const DriveRange& range,
                                               const DriveModel& model) {
  for (const double side : {1.0, -1.0}) {
    if (side > 0.0 ? range.forward < 0.05 : range.forward > 0.95) continue;
    for (const double share : {0.02, 0.1, 0.5, 1.0})
      for (const double place : {-0.8, 0.0, 0.8}) {
        DriveState state;
        state.velocity = side * std::max(range.slow, share * range.fast);
        state.direction = side;
        state.position = range.centre() + place * range.half();
        state.time_s = 0.5 * range.duration_s;
        double friction = 0.0;
        for (const FittedTerm& term : terms)
          if (rubs(term.term))
            for (std::size_t i = 0; i < term.functions.size(); ++i)
              friction += side * term.coefficients[i] * value_of(term.functions[i], state);
        if (friction < -0.02 * range.torque)
          return fmt::format("friction would push the drive, with {:.2g} {} at {:.2g} {}/s", -friction,
                             model.torque_unit, state.velocity, model.position_unit());
      }
  }
  return std::nullopt;
}

}  // namespace

std::vector<Impossibility> impossibilities(const std::vector<FittedTerm>& terms, const DriveRange& range,
                                           const DriveModel& model) {
  std::vector<Impossibility> all;
  const auto first = [&](DriveTerm wanted) {
    const FittedTerm* term = term_of(terms, wanted);
    return term == nullptr || term->coefficients.empty() ? std::nullopt
                                                         : std::optional(term->coefficients.front());
  };
  if (const auto inertia = first(DriveTerm::Inertia);
      inertia && *inertia * range.acceleration < -0.02 * range.torque)
    all.push_back({DriveTerm::Inertia, "the inertia would be negative"});
  if (const auto rise = first(DriveTerm::FrictionShape); rise && *rise < 0.0)
    all.push_back({DriveTerm::FrictionShape, "friction would be less at low speed; that is friction-power"});
  if (const auto power = first(DriveTerm::FrictionPower);
      power && *power < 0.0 && term_of(terms, DriveTerm::Viscous) == nullptr)
    all.push_back({DriveTerm::FrictionPower, "friction would fall with speed"});
  if (const FittedTerm* bristles = term_of(terms, DriveTerm::Presliding)) {
    const double level = bristles->coefficients.front();
    if (level < 0.0)
      all.push_back({DriveTerm::Presliding, "friction would be above its level after a reversal, not below"});
    else if (level > 2.4 * first(DriveTerm::Coulomb).value_or(0.0))
      all.push_back({DriveTerm::Presliding, "friction would lack more than twice itself after a reversal"});
    else if (bristles->coefficients.size() > 1 && bristles->coefficients[1] > 0.0)
      all.push_back(
          {DriveTerm::Presliding, "what builds up friction after a reversal would have negative damping"});
  }
  if (const auto load = first(DriveTerm::LoadFriction); load && *load < 0.0)
    all.push_back({DriveTerm::LoadFriction, "friction would be less under load"});
  if (const auto loss = first(DriveTerm::TorqueSaturation); loss && *loss > 1.0)
    all.push_back({DriveTerm::TorqueSaturation,
                   fmt::format("more than half of the {} would be lost to saturation", model.effort())});
  if (const FittedTerm* mass = term_of(terms, DriveTerm::InertiaPosition))
    for (const double place : {-1.0, 0.0, 1.0}) {
      DriveState state;
      state.acceleration = 1.0;
      state.position = range.centre() + place * range.half();
      double inertia = first(DriveTerm::Inertia).value_or(0.0);
      for (std::size_t i = 0; i < mass->functions.size(); ++i)
        inertia += mass->coefficients[i] * value_of(mass->functions[i], state);
      if (!(inertia < 0.0)) continue;
      all.push_back({DriveTerm::InertiaPosition, "the inertia would be negative at some place"});
      break;
    }
  if (auto friction = impossible_friction(terms, range, model))
    all.push_back({DriveTerm::Coulomb, std::move(*friction)});
  return all;
}

}  // namespace clampd::drive

namespace clampd {

std::string words_of(DriveTerm term, std::string_view effort) {
  switch (term) {
    case DriveTerm::Inertia:
      return "the drive has inertia";
    case DriveTerm::Viscous:
      return "the drive has viscous friction";
    case DriveTerm::Coulomb:
      return "the drive has dry friction";
    case DriveTerm::TorqueOffset:
      return fmt::format("a constant {0} pulls on the drive, or its {0} reading is biased", effort);
    case DriveTerm::FrictionAsymmetry:
      return "the drive's friction differs by direction";
    case DriveTerm::QuadraticDrag:
      return "friction grows with the square of speed";
    case DriveTerm::FrictionShape:
      return "friction rises at low speed (Stribeck)";
    case DriveTerm::Presliding:
      return "friction builds up over a length after each reversal";
    case DriveTerm::Cogging:
      return fmt::format("{} ripples periodically with position", effort);
    case DriveTerm::FrictionPosition:
      return "friction depends on where the drive is";
    case DriveTerm::LoadPosition:
      return "a load depends on where the drive is, like a spring or a cable";
    case DriveTerm::FrictionDrift:
      return "friction changes as the drive goes on, as by warming up";
    case DriveTerm::Gravity:
      return "gravity acts on the drive, with the sine and cosine of its angle";
    case DriveTerm::FrictionPower:
      return "friction does not grow in proportion to speed, but with a power of it";
    case DriveTerm::LoadFriction:
      return "friction grows with the load";
    case DriveTerm::TorqueSaturation:
      return fmt::format("{0} grows less than its reading, as with a saturating {0} constant", effort);
    case DriveTerm::TorqueLag:
      return fmt::format("{} and motion are recorded at different times", effort);
    case DriveTerm::InertiaPosition:
      return "the inertia depends on where the drive is";
    case DriveTerm::Regressor:
      return fmt::format("a recorded column is part of the {}", effort);
  }
  return "";
}

}  // namespace clampd
