#include "clampd/drive/model.hpp"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "clampd/record/file.hpp"
#include "src/drive/strict_reader.hpp"

namespace clampd {
namespace {

constexpr std::size_t kBaseTerms = 3;

class ModelReader : public drive::StrictReader {
 public:
  using StrictReader::StrictReader;

  DriveModel read() {
    DriveModel model;
    model.file = path_;
    known(document_, "", {"drive", "columns", "regressors", "files", "model", "data", "fitted"});
    if (const toml::table* drive = section("drive", true)) read_drive(*drive, model);
    const toml::table* columns = section("columns", true);
    if (columns != nullptr) read_columns(*columns, model.columns);
    if (const toml::table* regressors = section("regressors", false)) read_regressors(*regressors, model);
    if (columns != nullptr) read_load_position(*columns, model);
    if (const toml::table* files = section("files", false)) read_files(*files, model);
    for (std::size_t i = 0; i < kDriveTermCount; ++i)
      model.parts[i].use = i < kBaseTerms ? PartUse::Estimate : PartUse::Candidate;
    if (const toml::table* data = section("data", false)) read_data(*data, model);
    if (model.steady) model.parts[0].use = PartUse::Off;
    if (const toml::table* parts = section("model", false)) read_parts(*parts, model);
    return model;
  }

 private:
  void known(const toml::table& table, std::string_view name, std::initializer_list<std::string_view> keys) {
    for (const auto& [key, node] : table) {
      bool found = false;
      for (const std::string_view each : keys) found = found || key.str() == each;
      if (!found)
        refuse(node, fmt::format("unknown key {}{}{}; known are {}", key.str(), name.empty() ? "" : " in ",
                                 name, fmt::join(keys, ", ")));
    }
  }

  const toml::table* section(std::string_view name, bool required) {
    const toml::node* node = document_.get(name);
    if (node == nullptr) {
      if (required && !error_)
        error_ = Error{fmt::format("{}:1:1: the section [{}] is missing", path_, name)};
      return nullptr;
    }
    if (!node->is_table()) refuse(*node, fmt::format("{} must be a section [{}]", name, name));
    return node->as_table();
  }

  std::optional<std::string> text(const toml::table& table, std::string_view key) {
    const toml::node* node = table.get(key);
    if (node == nullptr) return std::nullopt;
    const std::optional<std::string> value = node->value<std::string>();
    if (!node->is_string() || value->empty()) {
      refuse(*node, fmt::format("{} must be a text in quotes", key));
      return std::nullopt;
    }
    return value;
  }

  std::optional<double> number(const toml::table& table, std::string_view key, bool positive) {
    const toml::node* node = table.get(key);
    if (node == nullptr) return std::nullopt;
    const std::optional<double> value = node->is_number() ? node->value<double>() : std::nullopt;
    if (!value || !std::isfinite(*value) || *value == 0.0 || (positive && *value < 0.0)) {
      refuse(*node, fmt::format("{} must be a {} number", key, positive ? "positive" : "finite, non-zero"));
      return std::nullopt;
    }
    return value;
  }

  void read_drive(const toml::table& drive, DriveModel& model) {
    known(drive, "[drive]", {"name", "kind", "unit"});
    model.name = text(drive, "name").value_or("drive");
    const std::string kind = text(drive, "kind").value_or("");
    if (kind != "rotary" && kind != "linear") {
      const toml::node* node = drive.get("kind");
      refuse(node == nullptr ? static_cast<const toml::node&>(drive) : *node,
             "kind must be \"rotary\" or \"linear\"");
    }
    model.linear = kind == "linear";
    model.torque_unit = text(drive, "unit").value_or(model.linear ? "N" : "N m");
    const auto is = [&](const char* unit) { return model.torque_unit == unit; };
    if (!is("N m") && !is("N") && !is("A") && !is("V") && !is("%"))
      refuse(*drive.get("unit"),
             "unit must be \"N m\", \"N\", \"A\", \"V\" or \"%\"; use scale for another one");
  }

  std::optional<ColumnSource> source(const toml::table& columns, std::string_view key) {
    const toml::node* node = columns.get(key);
    if (node == nullptr) return std::nullopt;
    const toml::table* table = node->as_table();
    if (table == nullptr) {
      const std::optional<std::string> column = text(columns, key);
      if (!column) return std::nullopt;
      return ColumnSource{*column};
    }
    known(*table, key, {"column", "scale", "wrap", "offset", "minus", "late_s", "use"});
    const std::optional<std::string> column = text(*table, "column");
    if (!column) refuse(*node, fmt::format("columns.{} needs column = \"...\"", key));
    ColumnSource source{column.value_or(""), number(*table, "scale", false).value_or(1.0),
                        number(*table, "wrap", true).value_or(0.0)};
    if (table->contains("offset")) source.offset = finite(*table, "offset");
    source.minus = text(*table, "minus").value_or("");
    if (table->contains("late_s")) source.late_s = finite(*table, "late_s");
    if (source.late_s != 0.0 && (key == "time" || key == "drive_enabled"))
      refuse(*table->get("late_s"), fmt::format("{} cannot be late; give late_s of the readings", key));
    return source;
  }

  double finite(const toml::table& table, std::string_view key) {
    const toml::node& node = *table.get(key);
    const double value = node.is_number() ? node.value_or(0.0) : std::numeric_limits<double>::quiet_NaN();
    if (std::isfinite(value)) return value;
    refuse(node, fmt::format("{} must be a finite number", key));
    return 0.0;
  }

  /// NAME = "column" or {column = "...", scale, offset, minus, use = "candidate", "estimate", "known-torque"
  /// or "off"}; or {per_file = true, use}, of which the values stand in [files].
  void read_regressors(const toml::table& regressors, DriveModel& model) {
    for (const auto& [key, node] : regressors) {
      DriveRegressor regressor{std::string(key.str())};
      const toml::table* table = node.as_table();
      regressor.per_file = table != nullptr && table->contains("per_file");
      if (regressor.per_file) {
        known(*table, key.str(), {"per_file", "use"});
        if ((*table)["per_file"].value_exact<bool>() != true)
          refuse(node, "per_file must be true, or left out beside a column");
      } else if (const std::optional<ColumnSource> each = source(regressors, key.str())) {
        model.columns.others.emplace_back(regressor.name, *each);
      } else {
        continue;
      }
      const std::string use = table == nullptr ? "candidate" : text(*table, "use").value_or("candidate");
      if (use == "estimate")
        regressor.use = PartUse::Estimate;
      else if (use == "off")
        regressor.use = PartUse::Off;
      else if (use == "known-torque")
        regressor.known_torque = true;
      else if (use != "candidate")
        refuse(node, fmt::format("use of {} must be \"candidate\", \"estimate\", \"known-torque\" or \"off\"",
                                 key.str()));
      model.regressors.push_back(regressor);
    }
  }

  /// [files."RUN.csv"] with a number for each regressor that is per file.
  void read_files(const toml::table& files, DriveModel& model) {
    std::vector<std::string> names;
    for (const DriveRegressor& regressor : model.regressors)
      if (regressor.per_file) names.push_back(regressor.name);
    for (const auto& [key, node] : files) {
      const toml::table* table = node.as_table();
      if (table == nullptr) {
        refuse(node,
               fmt::format("files.{} must be a section [files.\"{}\"]; a name with a dot needs the quotes",
                           key.str(), key.str()));
        continue;
      }
      DriveFile file{std::string(key.str()), {}};
      for (const auto& [name, value] : *table)
        if (std::ranges::find(names, name.str()) == names.end())
          refuse(
              value,
              value.is_table()
                  ? fmt::format(
                        "{}.{} is no file of [files]; a name with a dot needs quotes: [files.\"{}.{}\"]",
                        key.str(), name.str(), key.str(), name.str())
                  : fmt::format("{0} is no regressor that is per file; declare {0} = {{per_file = true}} in "
                                "[regressors]",
                                name.str()));
      for (const std::string& name : names) {
        if (!table->contains(name))
          refuse(node, fmt::format("[files.\"{}\"] lacks {}", key.str(), name));
        else
          file.values.push_back(finite(*table, name));
      }
      model.files.push_back(std::move(file));
    }
  }

  void read_columns(const toml::table& columns, ColumnMap& map) {
    known(columns, "[columns]", {"time", "torque", "position", "load_position", "velocity", "drive_enabled"});
    for (const std::string_view required : {"time", "torque"})
      if (!columns.contains(required)) refuse(columns, fmt::format("columns.{} is missing", required));
    if (!columns.contains("position") && !columns.contains("velocity"))
      refuse(columns, "columns.position or columns.velocity is needed");
    map.time = source(columns, "time").value_or(ColumnSource{});
    map.torque = source(columns, "torque").value_or(ColumnSource{});
    map.position = source(columns, "position");
    map.velocity = source(columns, "velocity");
    map.drive_enabled = source(columns, "drive_enabled");
    if (map.time.scale < 0.0) refuse(*columns.get("time"), "the scale of time must be positive");
    std::vector<std::string> used;
    for (const auto& [key, node] : columns) {
      const std::optional<ColumnSource> each = source(columns, key.str());
      if (!each) continue;
      for (const std::string& other : used)
        if (other == each->column) refuse(node, fmt::format("column {} is used twice", each->column));
      used.push_back(each->column);
    }
  }

  void read_load_position(const toml::table& columns, DriveModel& model) {
    const std::optional<ColumnSource> load = source(columns, "load_position");
    if (!load) return;
    if (!model.columns.position)
      refuse(*columns.get("load_position"),
             "columns.load_position needs columns.position, to be compared with");
    model.columns.others.emplace_back("load_position", *load);
    model.load_position = true;
  }

  void read_data(const toml::table& data, DriveModel& model) {
    known(data, "[data]", {"steady", "torque_held", "cut_off_Hz", "good_enough", "skip_lines"});
    for (const auto& [key, target] :
         {std::pair{"steady", &model.steady}, {"torque_held", &model.torque_held}}) {
      const toml::node* node = data.get(key);
      if (node == nullptr) continue;
      if (!node->is_boolean()) refuse(*node, fmt::format("{} must be true or false", key));
      *target = node->value_or(false);
    }
    if (const auto cut_off = number(data, "cut_off_Hz", true)) model.cut_off_Hz = *cut_off;
    if (const auto share = number(data, "good_enough", true)) model.good_enough = *share;
    if (const auto lines = number(data, "skip_lines", true))
      model.columns.skip_lines = static_cast<int>(std::min(*lines, 1e6));
  }

  void read_parts(const toml::table& parts, DriveModel& model) {
    for (const auto& [key, node] : parts) {
      std::size_t term = 0;
      while (term < kDriveTermCount && kDriveTermNames[term] != key.str()) ++term;
      if (term == kDriveTermCount) {
        refuse(node, fmt::format("unknown key {} in [model]; known are {}", key.str(),
                                 fmt::join(kDriveTermNames, ", ")));
        continue;
      }
      DrivePart& part = model.parts[term];
      const bool base = term < kBaseTerms;
      const std::string use = node.is_string() ? node.value_or(std::string{}) : std::string{};
      if (use == "estimate") {
        part.use = PartUse::Estimate;
      } else if (use == "off") {
        part.use = PartUse::Off;
      } else if (use == "candidate" && !base) {
        part.use = PartUse::Candidate;
      } else if (base && node.is_number() && std::isfinite(node.value_or(0.0))) {
        part = {PartUse::Fixed, node.value_or(0.0)};
      } else {
        refuse(node, fmt::format("{} must be {}", key.str(),
                                 base ? "\"estimate\", \"off\" or a number"
                                      : "\"candidate\", \"estimate\" or \"off\""));
      }
    }
  }
};

}  // namespace

Result<DriveModel> parse_drive_model(const std::string& text, const std::string& path) {
  try {
    const toml::table document = toml::parse(text, path);
    ModelReader reader(document, path);
    DriveModel model = reader.read();
    if (reader.error()) return tl::unexpected(*reader.error());
    return model;
  } catch (const toml::parse_error& error) {
    const toml::source_position at = error.source().begin;
    return failure(
        fmt::format("{}:{}:{}: not valid TOML: {}", path, at.line, at.column, error.description()));
  }
}

Result<DriveModel> read_drive_model(const std::string& path) {
  return read_file(path).and_then([&](const std::string& text) { return parse_drive_model(text, path); });
}

bool is_drive_model(const std::string& text) {
  return text.starts_with("[drive]") || text.find("\n[drive]") != std::string::npos;
}

}  // namespace clampd
