#pragma once

#include <cmath>
#include <span>
#include <string>
#include <type_traits>

#include <ceres/jet.h>

#include "clampd/brake/effect.hpp"

namespace clampd {

/// A number with its derivatives by up to eight others.
using Jet = ceres::Jet<double, 8>;

namespace effects_detail {

inline double value_of(double number) {
  return number;
}
inline double value_of(const Jet& number) {
  return number.a;
}

/// Sine and cosine at the price of one: a Jet's sine asks for both, and so does its cosine.
template <class T>
struct Turned {
  explicit Turned(const T& angle) : sine(angle), cosine(angle) {
    const double s = std::sin(value_of(angle)), c = std::cos(value_of(angle));
    if constexpr (std::is_same_v<T, double>) {
      sine = s;
      cosine = c;
    } else {
      sine = T(s, c * angle.v);
      cosine = T(c, -s * angle.v);
    }
  }
  T sine, cosine;
};

/// An effect's own parameters (all of its table) and states, as numbers of type T.
template <class T>
struct Own {
  const T* parameters;
  const T* states;  ///< at the start of the stretch
};

/// Indices of effects in the catalogue's order: what a lag or a limit makes of a reading depends on what came
/// before it, not on what was named first.
std::vector<std::size_t> chain_of(const std::vector<EffectValues>& effects);

/// The strength that is most certainly there, with its name where the effect has several.
std::string strength_in_words(const EffectInfo& info, std::span<const double> values, std::span<const double> sds);

/// A parameter of the role Choice or Refinement, as the enumerator that it numbers; they count from one.
template <class Enumeration, class T>
Enumeration chosen(const T& parameter) {
  return static_cast<Enumeration>(static_cast<int>(value_of(parameter) + 0.5));
}

/// From the torque reading to the torque that acts until the next row.
template <class T>
struct TorqueInput {
  T torque_Nm;
  T previous_torque_Nm, next_torque_Nm, later_torque_Nm;  ///< of the rows before and after
  double gap_s;
  double early_s = 0.0;        ///< at first another torque acts for so long,
  T early_torque_Nm = T(0.0);  ///< this one

  /// Changes all readings alike.
  template <class Change>
  void each_reading(const Change& change) {
    for (T* reading : {&previous_torque_Nm, &torque_Nm, &next_torque_Nm, &later_torque_Nm, &early_torque_Nm})
      change(*reading);
  }
};

/// One instant of a stretch of motion in one direction. An effect reads what came before it in this order,
/// and changes what it is about.
template <class T>
struct Instant {
  double time_s, run;
  double direction;     ///< +1 or -1
  double step_s = 0.0;  ///< of the integration that asks; 0 outside of one
  T elapsed_s;          ///< since the start of the stretch
  T travel;             ///< since then, signed (rad)
  T position, velocity;
  // force path
  T pad_position;
  T elastic_N;  ///< of the polynomial (3)
  T force_N;    ///< of the pads
  // friction (4), (5)
  T coulomb_Nm, static_Nm, viscous_Nm_s_rad;
  T level_Nm;        ///< of (4) without its sign, once all effects have had their share in the above
  T friction_ratio;  ///< what the friction level is multiplied with: the direction
  T opposing_Nm;     ///< any further torque against the motor's
  // torque balance (2)
  T torque_Nm, ratio_m_rad, inertia_kg_m2;
};

/// What the sensors make of a row.
template <class T>
struct Readout {
  double time_s, run;
  T force_N;         ///< true; then the reading
  T velocity_rad_s;  ///< true; then the reading
};

/// From one row to the next, for filters in the readings. The torque is held, so the velocity goes straight
/// as good as always, but for a reversal, where friction turns round: there it has a bend. The force is bent
/// all the way.
template <class T>
struct Transit {
  double gap_s;
  T force_before_N, force_after_N;
  T force_bend_N;  ///< second derivative times gap_s^2
  T velocity_before_rad_s, velocity_after_rad_s;
  T until_reversal_s;  ///< when the velocity passes zero, or comes to rest; 0: it does not
  T since_reversal_s;  ///< from there to the next row
  bool reverses() const { return value_of(until_reversal_s) > 0.0; }
};

/// Where an effect can act: the functions of Equations but the last.
enum class Stage { Torque, Pad, Force, Friction, Balance, Remember, Read, Filter };
inline constexpr std::size_t kStages = 8;

template <class T>
class Equations {
 public:
  virtual ~Equations() = default;
  /// Changes `input`; `states` are at the row and end at the next.
  virtual void on_torque(TorqueInput<T>& input, const Own<T>& own, T* states) const = 0;
  virtual void on_pad(Instant<T>& instant, const Own<T>& own) const = 0;
  virtual void on_force(Instant<T>& instant, const Own<T>& own) const = 0;
  virtual void on_friction(Instant<T>& instant, const Own<T>& own) const = 0;
  virtual void on_balance(Instant<T>& instant, const Own<T>& own) const = 0;
  /// Own states at the end of a stretch.
  virtual void on_remember(const Instant<T>& end, const Own<T>& own, T* states) const = 0;
  virtual void on_read(Readout<T>& readout, const Own<T>& own) const = 0;
  /// Own states of reading filters at the next row.
  virtual void on_filter(const Transit<T>& transit, const Own<T>& own, T* states) const = 0;
  /// Own states when everything has settled; `instant` holds force and torque.
  virtual void on_settle(const Instant<T>& instant, const Own<T>& own, T* states) const = 0;
};

/// y' = (u - y) / lag over a gap in which u goes from `before` to `after`, along a parabola whose second
/// derivative is `bend` / gap^2; y before is `state`.
template <class T, class Gap>
T first_order(const T& lag_s, const Gap& gap_s, const T& before, const T& after, const T& bend,
              const T& state) {
  using std::exp;
  const T share = lag_s / gap_s;
  // What y would be in the end, and at the beginning, had it followed this parabola for ever.
  const T end = after - share * (after - before + (0.5 - share) * bend);
  if (!(value_of(share) > 1e-3)) return end;
  const T beginning = before - share * (after - before - (0.5 + share) * bend);
  return end + (state - beginning) * exp(-1.0 / share);
}

/// s goes to the direction of motion over a travel of `reach`.
template <class T>
T turned_round(const T& state, const T& travel, double direction, const T& reach) {
  using std::exp;
  return direction + (state - direction) * exp(-direction * travel / reach);
}

/// The same in a straight line: by one over a travel of `reach`.
template <class T>
T turned_straight(const T& state, const T& travel, const T& reach) {
  const T turned = state + travel / reach;
  if (turned > 1.0) return T(1.0);
  return turned < -1.0 ? T(-1.0) : turned;
}

}  // namespace effects_detail

/// See EquationsOf, from which every effect derives.
class Effect : public effects_detail::Equations<double>, public effects_detail::Equations<Jet> {
 public:
  virtual const EffectInfo& info() const = 0;
  /// Whether it does anything there.
  virtual bool acts_on(effects_detail::Stage stage) const = 0;
  /// Whether substeps() may ask for more than one.
  virtual bool is_stiff() const { return false; }
  /// Of the next 1 ms, from how things are and what the brake's acceleration (rad/s^2) is.
  virtual int substeps(const effects_detail::Own<double>& own, const effects_detail::Instant<double>& now,
                       double acceleration) const {
    (void)own, (void)now, (void)acceleration;
    return 1;
  }
  virtual std::vector<double> starts(std::size_t parameter, std::span<const Run>) const {
    return info().parameters[parameter].starts;
  }
  /// Values that mean about the same once one of the parameters (index) is chosen otherwise.
  virtual std::vector<double> chosen_otherwise(std::vector<double> values, std::size_t parameter,
                                               double choice) const {
    values[parameter] = choice;
    return values;
  }
  /// See in_words(); unless said otherwise its cause, and how strong it is.
  virtual std::string in_words(std::span<const double> values, std::span<const double> sds, double amplitude) const;
  virtual EffectDelays delays(std::span<const double> values) const {
    (void)values;
    return {};
  }
};

/// An effect is written as templates over the number type; what it does not care about it leaves out.
template <class Derived>
class EquationsOf : public Effect {
  template <class T>
  using Own = effects_detail::Own<T>;

 public:
  template <class T>
  void torque(effects_detail::TorqueInput<T>&, const Own<T>&, T*) const {}
  template <class T>
  void pad(effects_detail::Instant<T>&, const Own<T>&) const {}
  template <class T>
  void force(effects_detail::Instant<T>&, const Own<T>&) const {}
  template <class T>
  void friction(effects_detail::Instant<T>&, const Own<T>&) const {}
  template <class T>
  void balance(effects_detail::Instant<T>&, const Own<T>&) const {}
  template <class T>
  void remember(const effects_detail::Instant<T>&, const Own<T>&, T*) const {}
  template <class T>
  void read(effects_detail::Readout<T>&, const Own<T>&) const {}
  template <class T>
  void filter(const effects_detail::Transit<T>&, const Own<T>&, T*) const {}
  template <class T>
  void settle(const effects_detail::Instant<T>&, const Own<T>&, T*) const {}

  bool acts_on(effects_detail::Stage stage) const final {
    using effects_detail::Stage;
    switch (stage) {
      case Stage::Torque:
        return is_own(&Derived::template torque<double>);
      case Stage::Pad:
        return is_own(&Derived::template pad<double>);
      case Stage::Force:
        return is_own(&Derived::template force<double>);
      case Stage::Friction:
        return is_own(&Derived::template friction<double>);
      case Stage::Balance:
        return is_own(&Derived::template balance<double>);
      case Stage::Remember:
        return is_own(&Derived::template remember<double>);
      case Stage::Read:
        return is_own(&Derived::template read<double>);
      case Stage::Filter:
        return is_own(&Derived::template filter<double>);
    }
    return true;
  }

#define CLAMPD_EQUATIONS(T)                                                                    \
  void on_torque(effects_detail::TorqueInput<T>& x, const Own<T>& own, T* s) const final {     \
    derived().torque(x, own, s);                                                               \
  }                                                                                            \
  void on_pad(effects_detail::Instant<T>& x, const Own<T>& own) const final {                  \
    derived().pad(x, own);                                                                     \
  }                                                                                            \
  void on_force(effects_detail::Instant<T>& x, const Own<T>& own) const final {                \
    derived().force(x, own);                                                                   \
  }                                                                                            \
  void on_friction(effects_detail::Instant<T>& x, const Own<T>& own) const final {             \
    derived().friction(x, own);                                                                \
  }                                                                                            \
  void on_balance(effects_detail::Instant<T>& x, const Own<T>& own) const final {              \
    derived().balance(x, own);                                                                 \
  }                                                                                            \
  void on_remember(const effects_detail::Instant<T>& x, const Own<T>& own, T* s) const final { \
    derived().remember(x, own, s);                                                             \
  }                                                                                            \
  void on_read(effects_detail::Readout<T>& x, const Own<T>& own) const final {                 \
    derived().read(x, own);                                                                    \
  }                                                                                            \
  void on_filter(const effects_detail::Transit<T>& x, const Own<T>& own, T* s) const final {   \
    derived().filter(x, own, s);                                                               \
  }                                                                                            \
  void on_settle(const effects_detail::Instant<T>& x, const Own<T>& own, T* s) const final {   \
    derived().settle(x, own, s);                                                               \
  }
  CLAMPD_EQUATIONS(double)
  CLAMPD_EQUATIONS(Jet)
#undef CLAMPD_EQUATIONS

 private:
  const Derived& derived() const {
    return static_cast<const Derived&>(*this);
  }
  template <class Owner, class... Arguments>
  static constexpr bool is_own(void (Owner::*)(Arguments...) const) {
    return std::is_same_v<Owner, Derived>;
  }
};

}  // namespace clampd
