#include "tests/drive_bench/files.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numbers>
#include <stdexcept>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace clampd::drive_bench {
namespace {

struct Columns {
  std::string torque, position, velocity;
  double position_scale = 1.0, velocity_scale = 1.0;  ///< of the model file: reading times scale is SI
};

Columns name_columns(const Case& c) {
  Columns names;
  names.torque = c.in_amperes ? "current_A" : c.plant.linear ? "force_N" : "torque_Nm";
  names.position = c.plant.linear ? "position_m" : "position_rad";
  names.velocity = c.plant.linear ? "velocity_m_s" : "velocity_rad_s";
  if (c.in_counts) names.position = "encoder_count", names.position_scale = c.rig.encoder_step;
  if (c.in_rpm) names.velocity = "speed_rpm", names.velocity_scale = 2.0 * std::numbers::pi / 60.0;
  return names;
}

void write_text(const std::string& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.close();
  if (!file) throw std::runtime_error("cannot write " + path + ": is there space, and may one write there?");
}

std::string run_text(const Case& c, const Columns& names, const Recording& run) {
  std::string text = "time_s," + names.torque;
  if (!run.position.empty()) text += "," + names.position;
  if (!run.velocity.empty()) text += "," + names.velocity;
  if (!run.load.empty()) text += ",load";
  text += "\n";
  auto out = std::back_inserter(text);
  for (std::size_t k = 0; k < run.time_s.size(); ++k) {
    fmt::format_to(out, "{:.9g},{:.8g}", run.time_s[k], run.torque[k] / c.torque_constant);
    if (!run.position.empty()) {
      const double position = run.position[k] / names.position_scale;
      if (c.in_counts)
        fmt::format_to(out, ",{}", std::llround(position));
      else
        fmt::format_to(out, ",{:.10g}", position);
    }
    if (!run.velocity.empty()) fmt::format_to(out, ",{:.8g}", run.velocity[k] / names.velocity_scale);
    if (!run.load.empty()) fmt::format_to(out, ",{:.8g}", run.load[k] / c.torque_constant);
    text += "\n";
  }
  return text;
}

std::string model_text(const Case& c, const Columns& names, bool all_keys) {
  std::string text = fmt::format(
      "[drive]\nname = \"{}\"\nkind = \"{}\"\nunit = \"{}\"\n\n[columns]\ntime = \"time_s\"\ntorque = "
      "\"{}\"\n",
      c.family->name, c.plant.linear ? "linear" : "rotary",
      c.in_amperes     ? "A"
      : c.plant.linear ? "N"
                       : "N m",
      names.torque);
  const auto add = [&](const char* quantity, const std::string& column, double scale) {
    text += scale == 1.0
                ? fmt::format("{} = \"{}\"\n", quantity, column)
                : fmt::format("{} = {{column = \"{}\", scale = {:.17g}}}\n", quantity, column, scale);
  };
  if (c.rig.has_position) add("position", names.position, names.position_scale);
  if (c.rig.has_velocity) add("velocity", names.velocity, names.velocity_scale);
  if (all_keys && c.plant.measured_load.is_there()) text += "\n[regressors]\nload = \"load\"\n";
  std::string data;
  if (c.rig.torque_column == TorqueColumn::Held) data += "torque_held = true\n";
  if (all_keys && c.good_enough > 0.0) data += fmt::format("good_enough = {:.4g}\n", c.good_enough);
  if (!data.empty()) text += "\n[data]\n" + data;
  return text;
}

}  // namespace

Files write_files(const Case& c, const std::vector<Recording>& runs, const std::string& folder,
                  bool all_keys) {
  const Columns names = name_columns(c);
  Files files;
  const std::filesystem::path root(folder);
  for (std::size_t run = 0; run < runs.size(); ++run) {
    files.runs.push_back((root / fmt::format("run-{}.csv", run + 1)).string());
    write_text(files.runs.back(), run_text(c, names, runs[run]));
  }
  files.model = (root / "model.toml").string();
  write_text(files.model, model_text(c, names, all_keys));
  return files;
}

std::string answer_json(const Case& c) {
  nlohmann::ordered_json json{{"seed", c.seed},
                              {"kind", to_string(c.kind)},
                              {"family", c.family->name},
                              {"half", c.family->development ? "development" : "held-out"},
                              {"in_words", in_words(c)},
                              {"spoil", c.spoil},
                              {"hidden", nlohmann::ordered_json::array()},
                              {"inertia", c.plant.inertia / c.torque_constant},
                              {"coulomb", c.plant.coulomb / c.torque_constant},
                              {"viscous", c.plant.viscous / c.torque_constant},
                              {"torque_constant", c.torque_constant}};
  for (const Hidden& hidden : c.hidden)
    json["hidden"].push_back({{"name", hidden.name}, {"form", hidden.form}, {"values", hidden.values}});
  return json.dump(2) + "\n";
}

}  // namespace clampd::drive_bench
