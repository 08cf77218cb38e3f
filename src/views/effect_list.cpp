#include "clampd/views/effect_list.hpp"

#include <cmath>

#include <fmt/format.h>

#include "clampd/brake/effect.hpp"
#include "clampd/drive/model.hpp"

namespace clampd {
namespace {

using nlohmann::ordered_json;

bool is_base(DriveTerm term) {
  return term == DriveTerm::Inertia || term == DriveTerm::Viscous || term == DriveTerm::Coulomb;
}

/// As `diagnose` calls them; a column of the user's own has its name behind the colon.
std::string called(DriveTerm term) {
  return std::string(name_of(term)) + (term == DriveTerm::Regressor ? ":NAME" : "");
}

template <class Function>
void for_each_drive_effect(const Function& function) {
  for (std::size_t i = 0; i < kDriveTermCount; ++i)
    if (const auto term = static_cast<DriveTerm>(i); !is_base(term)) function(term);
}

ordered_json parameter_json(const EffectParameter& parameter) {
  return {{"name", parameter.name},   {"unit", parameter.unit},   {"description", in_words(parameter)},
          {"lower", parameter.lower}, {"upper", parameter.upper}, {"estimated", is_estimated(parameter)}};
}

std::string bound(double value) {
  return std::isfinite(value) ? fmt::format("{:g}", value) : "any";
}

std::string parameter_line(const EffectParameter& parameter) {
  const std::string range = parameter.choices.empty()
                                ? fmt::format(", {} to {}", bound(parameter.lower), bound(parameter.upper))
                                : "";
  return fmt::format("    {:<16} {:<12} {}{}\n", parameter.name, parameter.unit, in_words(parameter), range);
}

}  // namespace

ordered_json effects_json() {
  ordered_json of_brakes = ordered_json::array(), of_drives = ordered_json::array();
  for (const Effect* effect : effects()) {
    const EffectInfo& info = info_of(*effect);
    ordered_json parameters = ordered_json::array();
    for (const EffectParameter& parameter : info.parameters) parameters.push_back(parameter_json(parameter));
    of_brakes.push_back({{"name", info.name},
                         {"location", to_string(info.location)},
                         {"origin", "catalogue"},
                         {"cause", info.cause},
                         {"excitation", info.excitation},
                         {"parameters", std::move(parameters)}});
  }
  for_each_drive_effect([&](DriveTerm term) {
    of_drives.push_back(
        {{"name", called(term)}, {"origin", "catalogue"}, {"cause", words_of(term, "torque")}});
  });
  return {{"schema", "clampd.effects/1"}, {"brake", std::move(of_brakes)}, {"drive", std::move(of_drives)}};
}

std::string format_effects() {
  std::string text = "Effects of a brake, beside stiffness and friction (clampctl diagnose RUN.csv...)\n";
  for (const Effect* effect : effects()) {
    const EffectInfo& info = info_of(*effect);
    text += fmt::format("\n{}: {}\n  {}; shown by {}\n", info.name, info.cause, to_string(info.location),
                        info.excitation);
    for (const EffectParameter& parameter : info.parameters) text += parameter_line(parameter);
  }
  text +=
      "\nEffects of a bare drive, beside inertia, viscous and Coulomb friction\n"
      "(clampctl diagnose RUN.csv... --model DRIVE.toml)\n\n";
  for_each_drive_effect(
      [&](DriveTerm term) { text += fmt::format("  {:<20} {}\n", called(term), words_of(term, "torque")); });
  text +=
      "\nWhere motor and load are both recorded (columns.load_position), the data also show the play of the\n"
      "gear: gear-backlash, gear-compliance, or gear-play where the two cannot be told apart.\n";
  return text;
}

}  // namespace clampd
