#include <algorithm>
#include <cmath>
#include <numbers>

#include "clampd/parameters/brake_parameters.hpp"
#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

/// Bristles bend before they slide. By Dahl's law and the elastic one they give way by the same deflection at
/// any level of friction; LuGre's have one stiffness (Canudas de Wit, Olsson, Astrom, Lischinsky 1995), and
/// so have the elasto-plastic ones, which do not give way at all up to a share of the level (Dupont, Hayward,
/// Armstrong, Altpeter 2002).
class Presliding final : public EquationsOf<Presliding> {
  enum Parameter { kDeflection, kLaw, kDamping };
  enum class Law { Dahl = 1, Elastic, LuGre, ElastoPlastic };

 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "presliding",
        .location = Location::TorqueBalance,
        .cause = "the friction gives way elastically before it slides",
        .excitation = "reversals, best under load",
        .parameters =
            {{.name = "deflection",
              .unit = "rad",
              .description =
                  "at which the friction is fully built up (LuGre's, elasto-plastic: a friction of TC)",
              .role = Role::Shape,
              .lower = 0.00001,
              .upper = 3,
              .scale = 0.2,
              .logarithmic = true,
              .starts = {0.0001, 0.0004, 0.0015, 0.006, 0.025, 0.1, 0.4}},
             {.name = "law",
              .unit = "",
              .description = "by which the friction builds up",
              .role = Role::Refinement,
              .lower = 1,
              .upper = 4,
              .starts = {1, 3, 4, 2},
              .choices = {"Dahl's", "elastic until it slides", "LuGre's", "elasto-plastic"}},
             {.name = "damping",
              .unit = "",
              .description = "of the bristles with the inertia; 1 is critical",
              .role = Role::Shape,
              .lower = 0,
              .upper = 3,
              .scale = 0.3,
              .starts = {0.1}}},
        // How far the bristles are bent, over the deflection; by the laws of one stiffness, the level of
        // friction then, over TC.
        .states = 2};
    return kInfo;
  }
  bool is_stiff() const override { return true; }
  /// The same stiffness under a medium load.
  std::vector<double> chosen_otherwise(std::vector<double> values, std::size_t parameter,
                                       double choice) const override {
    constexpr double kLoad_N = 1e4;
    const ParameterVector theta = nominal_parameters();
    const double level = (theta[Ts0] + theta[mus] * kLoad_N) / theta[TC];
    const bool had_one = has_one_stiffness(effects_detail::chosen<Law>(values[parameter]));
    const bool has_one = has_one_stiffness(effects_detail::chosen<Law>(choice));
    if (has_one && !had_one) values[kDeflection] /= level;
    if (!has_one && had_one) values[kDeflection] *= level;
    const EffectParameter& deflection = info().parameters[kDeflection];
    values[kDeflection] = std::clamp(values[kDeflection], deflection.lower, deflection.upper);
    values[parameter] = choice;
    return values;
  }
  int substeps(const effects_detail::Own<double>& own, const effects_detail::Instant<double>& now,
               double acceleration) const override {
    constexpr int kFewest = 4, kMax = 24;
    constexpr double kRow_s = 1e-3;
    constexpr double kBuiltUp = 0.99;
    constexpr double kResolution = 0.1;  // of the travel that builds friction up
    const double change = std::abs(acceleration) * kRow_s;
    const bool may_reverse = now.velocity * acceleration <= 0.0 && std::abs(now.velocity) < 2.0 * change;
    if (!may_reverse && now.direction * now.friction_ratio > kBuiltUp)
      return has_one_stiffness(law_of(own)) ? substeps_sliding(own, now) : 1;
    // The slowest part of the motion, around a reversal, decides how friction is built up: travel goes with
    // time squared.
    const double travel = (std::abs(now.velocity) + 0.5 * change) * kRow_s;
    const double reach = own.parameters[kDeflection] * std::max(1.0, now.level_Nm / now.coulomb_Nm);
    return std::clamp(static_cast<int>(std::ceil(std::sqrt(travel / (kResolution * reach)))), kFewest, kMax);
  }
  template <class T>
  void balance(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    const Law law = law_of(own);
    const T bristles = deflection_of(instant, own);
    const T level = has_one_stiffness(law) ? instant.coulomb_Nm : instant.level_Nm;
    instant.friction_ratio = has_one_stiffness(law) ? T(bristles * (level / instant.level_Nm)) : bristles;
    // The share of the motion that bends them further.
    const T built_up = instant.direction * instant.friction_ratio;
    T yielding = 1.0 - built_up;
    if (law == Law::Elastic) yielding = built_up < 1.0 ? T(1.0) : T(0.0);
    if (law == Law::ElastoPlastic) yielding = 1.0 - sliding_share(built_up) * built_up;
    using std::sqrt;
    const T critical = 2.0 * sqrt(level / own.parameters[kDeflection] * instant.inertia_kg_m2);
    instant.opposing_Nm += own.parameters[kDamping] * critical * instant.velocity * yielding;
  }
  template <class T>
  void remember(const effects_detail::Instant<T>& end, const effects_detail::Own<T>& own, T* states) const {
    states[0] = deflection_of(end, own);
    if (has_one_stiffness(law_of(own))) states[1] = end.level_Nm / end.coulomb_Nm;
  }
  template <class T>
  void settle(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own, T* states) const {
    const bool has_one = has_one_stiffness(law_of(own));
    const T unit = has_one ? instant.coulomb_Nm : instant.static_Nm;
    const T most = instant.static_Nm / unit;
    states[0] = (instant.torque_Nm - instant.ratio_m_rad * instant.force_N) / unit;
    if (states[0] > most) states[0] = most;
    if (states[0] < -most) states[0] = -most;
    states[1] = has_one ? T(instant.level_Nm / instant.coulomb_Nm) : T(1.0);
  }

 private:
  template <class T>
  static Law law_of(const effects_detail::Own<T>& own) {
    return effects_detail::chosen<Law>(own.parameters[kLaw]);
  }
  static bool has_one_stiffness(Law law) { return law == Law::LuGre || law == Law::ElastoPlastic; }

  /// Bristles that slide follow the level of friction, which falls with velocity, and their damping then acts
  /// like an inertia. The scheme knows the acceleration in it a step late only: as large as that is beside
  /// the brake's own inertia, as many steps.
  static int substeps_sliding(const effects_detail::Own<double>& own,
                              const effects_detail::Instant<double>& now) {
    constexpr int kMax = 4;
    constexpr double kAtOnce = 0.005;
    const double highest = now.static_Nm - now.coulomb_Nm;
    const double share = (now.level_Nm - now.coulomb_Nm) / highest;
    // d level / d velocity of the Stribeck curve (4), from where on it the brake is.
    const double slope = 2.0 * std::abs(highest / now.velocity) * share * (1.0 - share);
    const double apparent = 2.0 * own.parameters[kDamping] *
                            std::sqrt(own.parameters[kDeflection] * now.inertia_kg_m2 / now.coulomb_Nm) *
                            slope;
    const double steps = std::ceil(apparent / (kAtOnce * now.inertia_kg_m2));
    return steps < kMax ? std::max(1, static_cast<int>(steps)) : kMax;
  }

  /// From this share of the level on elasto-plastic bristles slide at all; Dupont's own examples.
  static constexpr double kBreakaway = 0.7;
  /// Of those bent by this share of the level in the direction of motion, the share of the motion that is
  /// sliding.
  template <class T>
  static T sliding_share(const T& built_up) {
    if (built_up <= kBreakaway) return T(0.0);
    if (built_up >= 1.0) return T(1.0);
    using std::cos;
    return 0.5 - 0.5 * cos(std::numbers::pi / (1.0 - kBreakaway) * (built_up - kBreakaway));
  }
  /// After a stretch of b' = travel - rate b.
  template <class T>
  static T after(const T& from, const T& travel, const T& rate) {
    using std::exp;
    return std::abs(effects_detail::value_of(rate)) > 1e-4
               ? T(from + (travel / rate - from) * (1.0 - exp(-rate)))
               : T(from + travel - rate * from);
  }
  /// b' = 1 - sliding_share(b) b over a travel of `reaches`, both over the level's deflection, while the
  /// level grows steadily by the share `growth`.
  template <class T>
  static T built_up_after(T built_up, T reaches, T growth) {
    constexpr double kSliding = 0.995;  // from here on all of the motion is, nearly
    constexpr double kLargest = 0.25, kFarthest = 4.0;
    if (built_up < kBreakaway) {
      // No sliding: the slope falls steadily up to the breakaway.
      const T travel = kBreakaway - built_up;
      const T slowest = reaches - growth * kBreakaway;
      const T relative = growth * travel / slowest;
      using std::log;
      const T share = travel / slowest *
                      (std::abs(effects_detail::value_of(relative)) > 1e-4 ? T(log(1.0 + relative) / relative)
                                                                           : T(1.0 - 0.5 * relative));
      if (!(slowest > 0.0) || !(share < 1.0)) return after(built_up, reaches, growth);
      built_up = T(kBreakaway);
      reaches *= 1.0 - share;
      growth *= 1.0 - share;
    }
    const bool is_far = reaches > kFarthest;
    const T near = is_far ? T(kFarthest / reaches) : T(1.0);
    const double distance = is_far ? kFarthest : std::max(0.0, effects_detail::value_of(reaches));
    const int steps = 1 + static_cast<int>(distance / kLargest);
    const T step = near * reaches / static_cast<double>(steps);
    const T growing = near * growth / static_cast<double>(steps);
    const auto slope = [&](const T& at) { return T(step * (1.0 - sliding_share(at) * at) - growing * at); };
    int taken = 0;
    for (; taken < steps && built_up < kSliding; ++taken) {
      const T first = slope(built_up);
      const T second = slope(built_up + 0.5 * first);
      const T third = slope(built_up + 0.5 * second);
      const T fourth = slope(built_up + third);
      built_up += (first + 2.0 * (second + third) + fourth) / 6.0;
    }
    if (taken == steps && !is_far) return built_up;
    const auto done = static_cast<double>(taken);
    const T left = reaches - done * step;
    return after(built_up, left, T(left + growth - done * growing));
  }

  /// How far the bristles are bent, over the deflection: a function of the travel.
  template <class T>
  static T deflection_of(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) {
    const T& deflection = own.parameters[kDeflection];
    const Law law = law_of(own);
    if (law == Law::Dahl)
      return effects_detail::turned_round(own.states[0], instant.travel, instant.direction, deflection);
    if (law == Law::LuGre) {
      // They follow a level that changes steadily over the stretch.
      const T level = instant.level_Nm / instant.coulomb_Nm;
      const T reaches = instant.direction * instant.travel / (deflection * 0.5 * (level + own.states[1]));
      using std::exp;
      const T left = exp(-reaches);
      const T lagging = reaches > 1e-4 ? T((1.0 - left) / reaches) : T(1.0 - 0.5 * reaches);
      return instant.direction * (level - lagging * (level - own.states[1])) +
             (own.states[0] - instant.direction * own.states[1]) * left;
    }
    if (law == Law::ElastoPlastic) {
      const T level = instant.level_Nm / instant.coulomb_Nm;
      const T mean = 0.5 * (level + own.states[1]);
      return instant.direction * level *
             built_up_after(T(instant.direction * own.states[0] / own.states[1]),
                            T(instant.direction * instant.travel / (deflection * mean)),
                            T((level - own.states[1]) / mean));
    }
    return effects_detail::turned_straight(own.states[0], instant.travel, deflection);
  }
};

}  // namespace

const Effect& presliding() {
  static const Presliding kEffect;
  return kEffect;
}

}  // namespace clampd
