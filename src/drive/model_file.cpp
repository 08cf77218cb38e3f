#include "clampd/drive/model.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/table_reader.hpp"
#include "clampd/record/file.hpp"

namespace clampd {
namespace {

constexpr std::size_t kBaseTerms = 3;
constexpr double kAboveZero = std::numeric_limits<double>::min();
constexpr double kGreatest = std::numeric_limits<double>::max();

/// As TableReader::text(), but not empty.
void read_text(TableReader& reader, std::string_view key, std::string& target) {
  reader.text(key, target);
  if (reader.has(key) && target.empty())
    reader.refuse(key, fmt::format("{} must be a text in quotes", reader.name(key)));
}

class ModelReader {
 public:
  ModelReader(const std::string& file, std::optional<Error>& error) : file_(file), error_(error) {}

  DriveModel read(const toml::table& document) {
    DriveModel model;
    model.file = file_;
    TableReader reader(document, "", file_, error_);
    const auto section = [&](std::string_view key, bool required, auto part) {
      if (required && !reader.has(key)) reader.refuse(key, fmt::format("the section [{}] is missing", key));
      if (const toml::table* table = reader.table(key)) {
        TableReader each(*table, std::string(key), file_, error_);
        (this->*part)(each, *table, model);
        each.finish();
      }
    };
    section("drive", true, &ModelReader::read_drive);
    section("columns", true, &ModelReader::read_columns);
    section("regressors", false, &ModelReader::read_regressors);
    // After the regressors: their terms find them by their places.
    if (load_position_) model.columns.others.emplace_back("load_position", *load_position_);
    section("files", false, &ModelReader::read_files);
    for (std::size_t i = 0; i < kDriveTermCount; ++i)
      model.parts[i].use = i < kBaseTerms ? PartUse::Estimate : PartUse::Candidate;
    section("data", false, &ModelReader::read_data);
    if (model.steady) model.parts[0].use = PartUse::Off;
    section("model", false, &ModelReader::read_parts);
    reader.table("fitted");  // which parse_fitted_drive() reads
    reader.finish();
    return model;
  }

 private:
  void read_drive(TableReader& drive, const toml::table&, DriveModel& model) {
    model.name = "drive";
    read_text(drive, "name", model.name);
    std::string kind;
    drive.choice("kind", kind, {"rotary", "linear"});
    if (kind.empty()) drive.refuse("kind", "drive.kind must be one of \"rotary\", \"linear\"");
    model.linear = kind == "linear";
    model.torque_unit = model.linear ? "N" : "N m";
    drive.choice("unit", model.torque_unit, {"N m", "N", "A", "V", "%"});
  }

  /// KEY = "column" or {column = "...", scale, wrap, offset, minus, late_s}; of a regressor also `use`.
  std::optional<ColumnSource> source(TableReader& parent, std::string_view key, bool regressor = false) {
    const toml::node* node = parent.at(key);
    if (node == nullptr) return std::nullopt;
    ColumnSource source;
    if (!node->is_table()) {
      read_text(parent, key, source.column);
      return source;
    }
    TableReader table(*node->as_table(), parent.name(key), file_, error_);
    if (!table.has("column")) parent.refuse(key, fmt::format("{} needs column = \"...\"", parent.name(key)));
    read_text(table, "column", source.column);
    table.number("scale", source.scale);
    if (source.scale == 0.0) table.refuse("scale", fmt::format("{} must not be zero", table.name("scale")));
    table.number("wrap", source.wrap, kAboveZero, kGreatest);
    table.number("offset", source.offset);
    read_text(table, "minus", source.minus);
    table.number("late_s", source.late_s);
    if (regressor) table.at("use");
    table.finish();
    return source;
  }

  /// NAME = "column" or {column = "...", ..., use = "candidate", "estimate", "known-torque" or "off"}; or
  /// {per_file = true, use}, of which the values stand in [files].
  void read_regressors(TableReader& regressors, const toml::table& names, DriveModel& model) {
    for (const auto& [key, node] : names) {
      DriveRegressor regressor{std::string(key.str())};
      std::string use = "candidate";
      if (const toml::table* table = node.as_table()) {
        TableReader reader(*table, regressors.name(key.str()), file_, error_);
        reader.choice("use", use, {"candidate", "estimate", "known-torque", "off"});
        if (reader.has("per_file")) {
          reader.boolean("per_file", regressor.per_file);
          if (!regressor.per_file)
            reader.refuse("per_file", "per_file must be true, or left out beside a column");
          reader.finish();
        }
      }
      regressor.use = use == "estimate" ? PartUse::Estimate
                      : use == "off"    ? PartUse::Off
                                        : PartUse::Candidate;
      regressor.known_torque = use == "known-torque";
      if (regressor.per_file)
        regressors.at(key.str());
      else if (const std::optional<ColumnSource> column = source(regressors, key.str(), true))
        model.columns.others.emplace_back(regressor.name, *column);
      model.regressors.push_back(regressor);
    }
  }

  /// [files."RUN.csv"] with a number for each regressor that is per file.
  void read_files(TableReader& files, const toml::table& names, DriveModel& model) {
    for (const auto& [key, node] : names) {
      files.at(key.str());
      const toml::table* table = node.as_table();
      if (table == nullptr)
        return files.refuse(
            key.str(),
            fmt::format("files.{0} must be a section [files.\"{0}\"]; a name with a dot needs the quotes",
                        key.str()));
      TableReader reader(*table, fmt::format("files.\"{}\"", key.str()), file_, error_);
      for (const auto& [name, value] : *table) refuse_foreign(reader, key.str(), name.str(), value, model);
      DriveFile file{std::string(key.str()), {}};
      for (const DriveRegressor& regressor : model.regressors) {
        if (!regressor.per_file) continue;
        if (!reader.has(regressor.name))
          reader.refuse(regressor.name, fmt::format("[files.\"{}\"] lacks {}", key.str(), regressor.name));
        double value = 0.0;
        reader.number(regressor.name, value);
        file.values.push_back(value);
      }
      model.files.push_back(std::move(file));
    }
  }

  static void refuse_foreign(TableReader& reader, std::string_view file, std::string_view name,
                             const toml::node& value, const DriveModel& model) {
    const auto known = [&](const DriveRegressor& each) { return each.per_file && each.name == name; };
    if (std::ranges::any_of(model.regressors, known)) return;
    reader.refuse(name, value.is_table()
                            ? fmt::format("{0}.{1} is no file of [files]; a name with a dot needs quotes: "
                                          "[files.\"{0}.{1}\"]",
                                          file, name)
                            : fmt::format("{0} is no regressor that is per file; declare {0} = {{per_file = "
                                          "true}} in [regressors]",
                                          name));
  }

  void read_columns(TableReader& columns, const toml::table& table, DriveModel& model) {
    for (const std::string_view required : {"time", "torque"})
      if (!columns.has(required)) columns.refuse(required, fmt::format("columns.{} is missing", required));
    if (!columns.has("position") && !columns.has("velocity"))
      columns.refuse("position", "columns.position or columns.velocity is needed");
    ColumnMap& map = model.columns;
    map.time = source(columns, "time").value_or(ColumnSource{});
    map.torque = source(columns, "torque").value_or(ColumnSource{});
    map.position = source(columns, "position");
    map.velocity = source(columns, "velocity");
    map.drive_enabled = source(columns, "drive_enabled");
    load_position_ = source(columns, "load_position");
    if (map.time.scale < 0.0) columns.refuse("time", "the scale of time must be positive");
    for (const auto& [key, late_s] : {std::pair{"time", map.time.late_s},
                                      {"drive_enabled", map.drive_enabled ? map.drive_enabled->late_s : 0.0}})
      if (late_s != 0.0)
        columns.refuse(key, fmt::format("{} cannot be late; give late_s of the readings", key));
    if (load_position_ && !map.position)
      columns.refuse("load_position", "columns.load_position needs columns.position, to be compared with");
    model.load_position = load_position_.has_value();
    columns.finish();  // before the names of the table are taken as given
    std::vector<std::string> used;
    for (const auto& [key, node] : table) {
      const std::optional<ColumnSource> each = source(columns, key.str());
      if (!each) return;
      if (std::ranges::find(used, each->column) != used.end())
        columns.refuse(key.str(), fmt::format("column {} is used twice", each->column));
      used.push_back(each->column);
    }
  }

  void read_data(TableReader& data, const toml::table&, DriveModel& model) {
    data.boolean("steady", model.steady);
    data.boolean("torque_held", model.torque_held);
    data.number("cut_off_Hz", model.cut_off_Hz, kAboveZero, kGreatest);
    data.number("good_enough", model.good_enough, kAboveZero, kGreatest);
    data.integer("skip_lines", model.columns.skip_lines, 1, 1'000'000);
  }

  void read_parts(TableReader& parts, const toml::table&, DriveModel& model) {
    for (std::size_t i = 0; i < kDriveTermCount; ++i) {
      const toml::node* node = parts.at(kDriveTermNames[i]);
      if (node == nullptr) continue;
      const bool base = i < kBaseTerms;
      DrivePart& part = model.parts[i];
      if (base && node->is_number()) {
        part.use = PartUse::Fixed;
        parts.number(kDriveTermNames[i], part.value);
        continue;
      }
      const std::string use = node->value_or(std::string{});
      if (use == "estimate")
        part.use = PartUse::Estimate;
      else if (use == "off")
        part.use = PartUse::Off;
      else if (use == "candidate" && !base)
        part.use = PartUse::Candidate;
      else
        parts.refuse(kDriveTermNames[i], fmt::format("{} must be {}", kDriveTermNames[i],
                                                     base ? "\"estimate\", \"off\" or a number"
                                                          : "\"candidate\", \"estimate\" or \"off\""));
    }
  }

  const std::string& file_;
  std::optional<Error>& error_;
  std::optional<ColumnSource> load_position_;
};

}  // namespace

Result<DriveModel> parse_drive_model(const std::string& text, const std::string& path) {
  const Result<toml::table> document = parse_toml(text, path);
  if (!document) return tl::unexpected(document.error());
  std::optional<Error> error;
  DriveModel model = ModelReader(path, error).read(*document);
  if (error) return tl::unexpected(*error);
  return model;
}

Result<DriveModel> read_drive_model(const std::string& path) {
  return read_file(path).and_then([&](const std::string& text) { return parse_drive_model(text, path); });
}

bool is_drive_model(const std::string& text) {
  return text.starts_with("[drive]") || text.find("\n[drive]") != std::string::npos;
}

}  // namespace clampd
