#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "clampd/base/result.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "tests/support/blind/hidden_plant.hpp"

namespace clampd::blind {

enum class Kind {
  None,     ///< the base model is true
  Single,   ///< one effect of the product's list
  OffList,  ///< one that is not on it
  Pair,     ///< two of the list
};
enum class Generator {
  Station,      ///< drivers/sim under the product's own controller; the forms of its effects are fixed
  Independent,  ///< HiddenPlant, which shares nothing with the product; random forms
};
std::string_view to_string(Kind kind) noexcept;
std::string_view to_string(Generator generator) noexcept;

struct Request {
  Kind kind = Kind::Single;
  Generator generator = Generator::Independent;
  std::uint64_t seed = 1;
  std::string effect = {};  ///< the (first) one to hide; empty: drawn
  /// Whether a row's torque is computed from that row's readings, by a drive drawn at random around a brake
  /// that often lies at the ends of its range; of the independent generator only.
  bool feedback = false;
  bool reduced = false;  ///< a random part of the runs, down to one
};

/// An effect as it was drawn.
struct HiddenEffect {
  std::string name;
  std::string form;
  std::vector<std::pair<std::string, double>> values;  ///< with the unit in the name
  /// Where a diagnosis may place it: the contract's words.
  std::vector<std::string> locations;
  std::function<void(Physics&)> onto_physics;       ///< independent generator
  std::function<void(sim::Effects&)> onto_effects;  ///< station
};

/// What is hidden; together with the code it determines every reading.
struct Answer {
  Request request;
  std::vector<HiddenEffect> effects;
  BrakeParameters brake;
  Feedback feedback;
  NoiseLevels noise;
  std::vector<std::string> manoeuvres;  ///< one a run, in chronological order
};

struct BlindSet {
  Answer answer;
  std::vector<Run> runs;
  /// The same brake and effects without the sensors' noise, for scoring only.
  std::vector<Run> noise_free;
};

std::vector<std::string_view> effect_names(bool on_list, Generator generator);

Answer draw_answer(const Request& request);

/// Drives the brake. Errors: the station's supervisor refused to drive a brake with these effects.
Result<BlindSet> simulate(const Answer& answer);

/// draw_answer() and simulate(); where a brake cannot be driven, another is drawn from the same seed.
Result<BlindSet> make_set(const Request& request);

/// Run files run-01-optimal.csv, ... into the folder, which is made. Nothing of the answer goes there.
Result<std::vector<std::string>> write_runs(const std::vector<Run>& runs, const std::string& folder);

std::string answer_json(const Answer& answer);

}  // namespace clampd::blind
