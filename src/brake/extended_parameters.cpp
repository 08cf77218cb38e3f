#include <cmath>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "clampd/base/toml_location.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/record/file.hpp"

namespace clampd {

namespace {

Result<EffectValues> read_effect(const std::string& path, const toml::table& table) {
  const auto name = table["name"].value<std::string>();
  if (!name) return failure(fmt::format("{}: an [[effect]] needs a name", location_of(path, table)));
  const Effect* effect = find_effect(*name);
  if (effect == nullptr) {
    std::string known;
    for (const Effect* other : effects()) known += fmt::format(" {}", info_of(*other).name);
    return failure(
        fmt::format("{}: there is no effect \"{}\"; known are{}", location_of(path, table), *name, known));
  }
  const EffectInfo& info = info_of(*effect);
  for (const auto& [key, node] : table) {
    const std::string_view found = key.str();
    const bool known = found == "name" || std::any_of(info.parameters.begin(), info.parameters.end(),
                                                      [&](const auto& p) { return p.name == found; });
    if (!known)
      return failure(
          fmt::format("{}: effect {} has no parameter \"{}\"", location_of(path, node), *name, found));
  }
  EffectValues values{effect, {}};
  for (const EffectParameter& parameter : info.parameters) {
    const toml::node* node = table.get(parameter.name);
    if (node == nullptr && parameter.role == EffectParameter::Role::Refinement) {
      // What a model does not say of an effect's form is as the effect was before it knew others.
      values.values.push_back(parameter.starts.front());
      continue;
    }
    if (node == nullptr)
      return failure(fmt::format("{}: effect {} lacks its parameter {} ({})", location_of(path, table), *name,
                                 parameter.name, in_words(parameter)));
    const auto value = node->value<double>();
    if (!value || !(*value >= parameter.lower && *value <= parameter.upper))
      return failure(fmt::format("{}: {} of effect {} must be a number within {} ... {} {}",
                                 location_of(path, *node), parameter.name, *name, parameter.lower,
                                 parameter.upper, parameter.unit));
    values.values.push_back(*value);
  }
  return values;
}

}  // namespace

Result<ExtendedParameters> read_extended_parameters(const std::string& path) {
  const auto text = read_file(path);
  if (!text) return tl::unexpected(text.error());
  return parse_extended_parameters(*text, path);
}

Result<ExtendedParameters> parse_extended_parameters(std::string_view text, const std::string& path) {
  const auto base = parse_brake_parameters(text, path);
  if (!base) return tl::unexpected(base.error());
  ExtendedParameters parameters{*base, {}};
  const toml::table document = toml::parse(text, path);  // valid, or the base had said so
  const toml::node* node = document.get("effect");
  if (node == nullptr) return parameters;
  const toml::array* tables = node->as_array();
  if (tables == nullptr)
    return failure(fmt::format("{}: write each effect as a table [[effect]]", location_of(path, *node)));
  for (const toml::node& entry : *tables) {
    if (!entry.is_table())
      return failure(fmt::format("{}: write each effect as a table [[effect]]", location_of(path, entry)));
    const auto effect = read_effect(path, *entry.as_table());
    if (!effect) return tl::unexpected(effect.error());
    if (!room_for(parameters, {&*effect, 1}))
      return failure(fmt::format("{}: too many effects in one model", location_of(path, entry)));
    parameters.effects.push_back(*effect);
  }
  return parameters;
}

std::string format_extended_parameters(const ExtendedParameters& parameters) {
  std::string text = "[parameters]\n";
  for (std::size_t i = 0; i < kParameterCount; ++i)
    text += fmt::format("{} = {:.17g}  # {}\n", kParameterTable[i].name,
                        parameters.base.theta[static_cast<Eigen::Index>(i)], kParameterTable[i].unit);
  text += fmt::format("\n[fixed]\ninertia_kg_m2 = {:.17g}\nratio_m_rad = {:.17g}\n",
                      parameters.base.fixed.inertia_kg_m2, parameters.base.fixed.ratio_m_rad);
  for (const EffectValues& values : parameters.effects) {
    const EffectInfo& info = info_of(*values.effect);
    text += fmt::format("\n[[effect]]\nname = \"{}\"\n", info.name);
    for (std::size_t i = 0; i < info.parameters.size(); ++i) {
      const EffectParameter& parameter = info.parameters[i];
      text += fmt::format("{} = {:.17g}  # {}{}{}\n", parameter.name, values.values[i], parameter.unit,
                          parameter.unit.empty() ? "" : ", ", in_words(parameter));
    }
  }
  return text;
}

EffectDelays delays_of(const ExtendedParameters& model) {
  EffectDelays sum;
  for (const EffectValues& values : model.effects) {
    const EffectDelays each = delays_of(values);
    sum = {sum.force + each.force, sum.velocity + each.velocity, sum.torque + each.torque};
  }
  return sum;
}

double value_at(const ExtendedParameters& model, const ExtendedBrake::Place& place) {
  return place.effect < 0 ? model.base.theta[place.parameter]
                          : model.effects[static_cast<std::size_t>(place.effect)]
                                .values[static_cast<std::size_t>(place.parameter)];
}

bool room_for(const ExtendedParameters& model, std::span<const EffectValues> further) {
  int states = 2;
  std::size_t parameters = kParameterCount;
  const auto add = [&](const EffectValues& values) {
    states += info_of(*values.effect).states;
    parameters += values.values.size();
  };
  std::for_each(model.effects.begin(), model.effects.end(), add);
  std::for_each(further.begin(), further.end(), add);
  return states <= ExtendedBrake::kMaxStates &&
         parameters <= static_cast<std::size_t>(ExtendedBrake::kMaxParameters);
}

double& value_at(ExtendedParameters& model, const ExtendedBrake::Place& place) {
  return place.effect < 0 ? model.base.theta[place.parameter]
                          : model.effects[static_cast<std::size_t>(place.effect)]
                                .values[static_cast<std::size_t>(place.parameter)];
}

const EffectParameter& parameter_at(const ExtendedParameters& model, const ExtendedBrake::Place& place) {
  return info_of(*model.effects[static_cast<std::size_t>(place.effect)].effect)
      .parameters[static_cast<std::size_t>(place.parameter)];
}

}  // namespace clampd
