#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "tests/drive_bench/rig.hpp"

namespace clampd::drive_bench {

/// A kind of machine with the motions that its users make. The halves of the bench share no family and no
/// unlisted effect: whoever tunes a diagnosis may look at the development half only.
struct Family {
  std::string_view name;
  bool development;
  bool linear;
  bool under_gravity;
  double least_inertia, most_inertia;
  double least_speed, most_speed;  ///< under gravity: of the amplitude, rad or m
  double least_pace_Hz, most_pace_Hz;
  double least_friction, most_friction;  ///< Coulomb level over inertial torque
  std::vector<MotionKind> motions;
};
const std::vector<Family>& families();

enum class Kind { None, Single, Pair, Unlisted, BadData };
std::string_view to_string(Kind kind);

/// What is hidden: the name that the contract gives it (for bad data the finding's), and its sizes.
struct Hidden {
  std::string name;
  std::string form;
  std::map<std::string, double> values;
};

/// A case, drawn from its seed and nothing else.
struct Case {
  std::uint64_t seed = 0;
  Kind kind = Kind::None;
  const Family* family = nullptr;
  Plant plant;
  Rig rig;
  MotionRequest motion;
  int runs = 1;
  double torque_scale = 1.0;  ///< of what the base model needs
  double band_Hz = 1.0;       ///< what the motion and the effect move in; sensors are good enough for it
  std::vector<Hidden> hidden;
  std::string spoil;  ///< BadData: how the data are spoiled
  /// What the model file calls good enough, as a share of the torque; 0: not said, and then 5 %.
  double good_enough = 0.0;
  // How the files present the columns.
  bool in_amperes = false, in_counts = false, in_rpm = false;
  double torque_constant = 1.0;
};

/// `effect`: a name (or a name and a form, "friction-power/below-one") that the case is to hide, instead of a
/// drawn one.
Case draw_case(std::uint64_t seed, const std::string& effect = {});

/// The runs of a case. Every call gives the same ones.
std::vector<Recording> record_runs(const Case& drawn);

/// One line: the drive, the motion, the logger.
std::string in_words(const Case& drawn);

namespace detail {
struct EffectDraw {
  std::string_view name, form;
  bool needs_position, needs_rotary, needs_gravity, needs_both_ways, needs_friction, needs_inertia,
      needs_runs;
  void (*apply)(Case& drawn, Random& random, double size, Hidden& hidden);
};
const std::vector<EffectDraw>& listed_effects();
const std::vector<EffectDraw>& unlisted_effects(bool development);
const std::vector<std::string>& spoils();
/// Position's amplitude of a case, inertial torque at its pace.
double travel(const Case& drawn);
double inertial_torque(const Case& drawn);
}  // namespace detail

}  // namespace clampd::drive_bench
