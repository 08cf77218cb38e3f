#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class StiffnessHysteresis final : public EquationsOf<StiffnessHysteresis> {
  enum Parameter { kShare, kTravel, kLaw };
  enum class Law { Travel = 1, ReleasingSpeed, Speed, LinearTravel };
  /// By the laws of speed, the one at which the loop turns round is the travel within this time.
  static constexpr double kWithin_s = 0.01;

 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "stiffness-hysteresis",
        .location = Location::Stiffness,
        .cause = "the pads push back less on release than on apply",
        .excitation = "reversals under load",
        .parameters = {{.name = "share",
                        .unit = "1",
                        .description = "of the force that is missing on release",
                        .lower = 0,
                        .upper = 0.7,
                        .scale = 0.02},
                       {.name = "travel",
                        .unit = "rad",
                        .description = "that turns the loop round (by speed: within 10 ms)",
                        .role = Role::Shape,
                        .lower = 0.005,
                        .upper = 20,
                        .scale = 0.2,
                        .logarithmic = true,
                        .starts = {0.1, 0.5, 2.5}},
                       {.name = "law",
                        .unit = "",
                        .description = "what turns the loop round",
                        .role = Role::Refinement,
                        .lower = 1,
                        .upper = 4,
                        .starts = {1, 4, 2, 3},
                        .choices = {"travel", "speed, missing while the pads move back",
                                    "speed, half of it missing at rest", "travel, in a straight line"}}},
        .states = 1};
    return kInfo;
  }
  template <class T>
  void force(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.force_N *= 1.0 - 0.5 * own.parameters[kShare] * (1.0 - side(instant, own));
  }
  template <class T>
  void remember(const effects_detail::Instant<T>& end, const effects_detail::Own<T>& own, T* states) const {
    states[0] = turned_by_travel(end, own);
  }
  template <class T>
  void settle(const effects_detail::Instant<T>&, const effects_detail::Own<T>&, T* states) const {
    states[0] = T(-1.0);
  }

 private:
  template <class T>
  static T turned_by_travel(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) {
    const T& travel = own.parameters[kTravel];
    if (effects_detail::chosen<Law>(own.parameters[kLaw]) != Law::LinearTravel)
      return effects_detail::turned_round(own.states[0], instant.travel, instant.direction, travel);
    return effects_detail::turned_straight(own.states[0], instant.travel, T(0.5 * travel));
  }

  /// Of the loop: 1 on apply, -1 on release.
  template <class T>
  static T side(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) {
    using std::tanh;
    const T& travel = own.parameters[kTravel];
    const auto law = effects_detail::chosen<Law>(own.parameters[kLaw]);
    if (law == Law::Travel || law == Law::LinearTravel) return turned_by_travel(instant, own);
    const T by_speed = tanh(instant.velocity * kWithin_s / travel);
    if (law == Law::Speed) return by_speed;
    return by_speed < 0.0 ? T(1.0 + 2.0 * by_speed) : T(1.0);
  }
};

}  // namespace

const Effect& stiffness_hysteresis() {
  static const StiffnessHysteresis kEffect;
  return kEffect;
}

}  // namespace clampd
