#include <algorithm>
#include <cmath>

#include "clampd/brake/parameters.hpp"
#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

/// Bristles bend before they slide. By Dahl's law and the elastic one they give way by the same deflection at
/// any level of friction; LuGre's have one stiffness (Canudas de Wit, Olsson, Astrom, Lischinsky 1995).
class Presliding final : public EquationsOf<Presliding> {
  enum Parameter { kDeflection, kLaw, kDamping };
  enum class Law { Dahl = 1, Elastic, LuGre };

 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "presliding",
        .location = Location::TorqueBalance,
        .cause = "the friction gives way elastically before it slides",
        .excitation = "reversals, best under load",
        .parameters = {{.name = "deflection",
                        .unit = "rad",
                        .description = "at which the friction is fully built up (LuGre: a friction of TC)",
                        .role = Role::Shape,
                        .lower = 0.00001,
                        .upper = 3,
                        .scale = 0.2,
                        .logarithmic = true,
                        .starts = {0.0001, 0.0004, 0.0015, 0.006, 0.025, 0.1, 0.4}},
                       {.name = "law",
                        .unit = "",
                        .description = "1 Dahl's; 2 elastic until it slides; 3 LuGre's",
                        .role = Role::Refinement,
                        .lower = 1,
                        .upper = 3,
                        .starts = {1, 3, 2}},
                       {.name = "damping",
                        .unit = "",
                        .description = "of the bristles with the inertia; 1 is critical",
                        .role = Role::Shape,
                        .lower = 0,
                        .upper = 3,
                        .scale = 0.3,
                        .starts = {0.1}}},
        // How far the bristles are bent, over the deflection; LuGre's: the level of friction then, over TC.
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
    const auto is_lugre = [](double law) { return effects_detail::chosen<Law>(law) == Law::LuGre; };
    if (is_lugre(choice) && !is_lugre(values[parameter])) values[kDeflection] /= level;
    if (!is_lugre(choice) && is_lugre(values[parameter])) values[kDeflection] *= level;
    const EffectParameter& deflection = info().parameters[kDeflection];
    values[kDeflection] = std::clamp(values[kDeflection], deflection.lower, deflection.upper);
    values[parameter] = choice;
    return values;
  }
  int substeps(const effects_detail::Own<double>& own, const effects_detail::Instant<double>& now,
               double acceleration) const override {
    constexpr int kFewest = 4, kMost = 24;
    constexpr double kRow_s = 1e-3;
    constexpr double kBuiltUp = 0.99;
    constexpr double kResolution = 0.1;  // of the travel that builds friction up
    const double change = std::abs(acceleration) * kRow_s;
    const bool may_reverse = now.velocity * acceleration <= 0.0 && std::abs(now.velocity) < 2.0 * change;
    if (!may_reverse && now.direction * now.grip > kBuiltUp)
      return law_of(own) == Law::LuGre ? kFewest : 1;  // whose bristles follow the level of friction
    // The slowest part of the motion, around a reversal, decides how friction is built up: travel goes with
    // time squared.
    const double travel = (std::abs(now.velocity) + 0.5 * change) * kRow_s;
    const double reach = own.parameters[kDeflection] * std::max(1.0, now.level_Nm / now.coulomb_Nm);
    return std::clamp(static_cast<int>(std::ceil(std::sqrt(travel / (kResolution * reach)))), kFewest, kMost);
  }
  template <class T>
  void balance(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    const Law law = law_of(own);
    const T bristles = bent(instant, own);
    const T level = law == Law::LuGre ? instant.coulomb_Nm : instant.level_Nm;
    instant.grip = law == Law::LuGre ? T(bristles * (level / instant.level_Nm)) : bristles;
    T yielding = 1.0 - instant.direction * instant.grip;  // the share of the motion that bends them further
    if (law == Law::Elastic) yielding = instant.direction * bristles < 1.0 ? T(1.0) : T(0.0);
    using std::sqrt;
    const T critical = 2.0 * sqrt(level / own.parameters[kDeflection] * instant.inertia_kg_m2);
    instant.opposing_Nm += own.parameters[kDamping] * critical * instant.velocity * yielding;
  }
  template <class T>
  void remember(const effects_detail::Instant<T>& end, const effects_detail::Own<T>& own, T* states) const {
    states[0] = bent(end, own);
    if (law_of(own) == Law::LuGre) states[1] = end.level_Nm / end.coulomb_Nm;
  }
  template <class T>
  void settle(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own, T* states) const {
    const T unit = law_of(own) == Law::LuGre ? instant.coulomb_Nm : instant.static_Nm;
    const T most = instant.static_Nm / unit;
    states[0] = (instant.torque_Nm - instant.ratio_m_rad * instant.force_N) / unit;
    if (states[0] > most) states[0] = most;
    if (states[0] < -most) states[0] = -most;
    states[1] = law_of(own) == Law::LuGre ? T(instant.level_Nm / instant.coulomb_Nm) : T(1.0);
  }

 private:
  template <class T>
  static Law law_of(const effects_detail::Own<T>& own) {
    return effects_detail::chosen<Law>(own.parameters[kLaw]);
  }
  /// How far the bristles are bent, over the deflection: a function of the travel.
  template <class T>
  static T bent(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) {
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
    const T bent = own.states[0] + instant.travel / deflection;
    if (bent > 1.0) return T(1.0);
    return bent < -1.0 ? T(-1.0) : bent;
  }
};

}  // namespace

const Effect& presliding() {
  static const Presliding kEffect;
  return kEffect;
}

}  // namespace clampd
