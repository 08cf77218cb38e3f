#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <sstream>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "clampd/base/table_reader.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/record/file.hpp"

/// The section [fitted] of a model file: terms with their functions, coefficients and covariance.
namespace clampd {
namespace {

constexpr std::array<std::string_view, 5> kCarrierNames{"one", "acceleration", "velocity", "direction",
                                                        "sliding"};
constexpr std::array<std::string_view, 19> kFactorNames{
    "one",         "power",       "stribeck", "reversal",   "place",        "place-squared", "place-cubed",
    "cosine",      "sine",        "time",     "time-decay", "run",          "in-run",        "column",
    "column-size", "static-load", "load",     "balance",    "balance-power"};

template <std::size_t N>
std::optional<std::size_t> index_of(const std::array<std::string_view, N>& names, std::string_view name) {
  const auto at = std::find(names.begin(), names.end(), name);
  if (at == names.end()) return std::nullopt;
  return static_cast<std::size_t>(at - names.begin());
}

toml::array number_array(std::span<const double> values) {
  toml::array array;
  for (const double value : values) array.push_back(value);
  return array;
}

toml::table source_table(const ColumnSource& source) {
  toml::table table{{"column", source.column}};
  if (source.scale != 1.0) table.insert("scale", source.scale);
  if (source.wrap != 0.0) table.insert("wrap", source.wrap);
  if (source.offset != 0.0) table.insert("offset", source.offset);
  if (!source.minus.empty()) table.insert("minus", source.minus);
  if (source.late_s != 0.0) table.insert("late_s", source.late_s);
  return table;
}

toml::table columns_table(const DriveModel& model) {
  toml::table table{{"time", source_table(model.columns.time)},
                    {"torque", source_table(*model.columns.torque)}};
  if (model.columns.position) table.insert("position", source_table(*model.columns.position));
  if (model.load_position) table.insert("load_position", source_table(model.columns.others.back().second));
  if (model.columns.velocity) table.insert("velocity", source_table(*model.columns.velocity));
  if (model.columns.drive_enabled) table.insert("drive_enabled", source_table(*model.columns.drive_enabled));
  return table;
}

toml::table regressors_table(const DriveModel& model) {
  toml::table table;
  auto column = model.columns.others.begin();
  for (const DriveRegressor& regressor : model.regressors) {
    toml::table each =
        regressor.per_file ? toml::table{{"per_file", true}} : source_table((column++)->second);
    each.insert("use", regressor.known_torque               ? "known-torque"
                       : regressor.use == PartUse::Estimate ? "estimate"
                       : regressor.use == PartUse::Off      ? "off"
                                                            : "candidate");
    table.insert(regressor.name, each);
  }
  return table;
}

toml::table files_table(const DriveModel& model) {
  toml::table table;
  for (const DriveFile& file : model.files) {
    toml::table each;
    auto value = file.values.begin();
    for (const DriveRegressor& regressor : model.regressors)
      if (regressor.per_file) each.insert(regressor.name, *value++);
    table.insert(file.name, each);
  }
  return table;
}

toml::table parts_table(const DriveModel& model) {
  toml::table table;
  for (std::size_t i = 0; i < kDriveTermCount; ++i) {
    if (static_cast<DriveTerm>(i) == DriveTerm::Regressor) continue;
    const DrivePart& part = model.parts[i];
    if (part.use == PartUse::Fixed)
      table.insert(kDriveTermNames[i], part.value);
    else
      table.insert(kDriveTermNames[i], part.use == PartUse::Estimate ? "estimate"
                                       : part.use == PartUse::Off    ? "off"
                                                                     : "candidate");
  }
  return table;
}

toml::table data_table(const DriveModel& model) {
  toml::table table{
      {"steady", model.steady}, {"torque_held", model.torque_held}, {"good_enough", model.good_enough}};
  if (!std::isnan(model.cut_off_Hz)) table.insert("cut_off_Hz", model.cut_off_Hz);
  if (model.columns.skip_lines > 0) table.insert("skip_lines", model.columns.skip_lines);
  return table;
}

toml::table fitted_table(const FittedDrive& drive) {
  toml::table table{{"lag_s", drive.lag_s}, {"slow_speed", drive.slow_speed}};
  if (drive.settling_s > 0.0) table.insert("settling_s", drive.settling_s);
  if (!std::isnan(drive.cut_off_Hz)) table.insert("cut_off_Hz", drive.cut_off_Hz);
  if (!std::isnan(drive.error_rms)) table.insert("error_rms", drive.error_rms);
  toml::array terms;
  for (const FittedTerm& term : drive.terms) {
    toml::array functions;
    for (const BasisFunction& function : term.functions) {
      toml::table each{{"carrier", kCarrierNames[static_cast<std::size_t>(function.carrier)]},
                       {"factor", kFactorNames[static_cast<std::size_t>(function.factor)]},
                       {"first", function.first},
                       {"second", function.second}};
      if (function.index >= 0) each.insert("index", function.index);
      functions.push_back(each);
    }
    terms.push_back(toml::table{
        {"name", term.name}, {"coefficients", number_array(term.coefficients)}, {"functions", functions}});
  }
  table.insert("term", terms);
  toml::array covariance;
  for (Eigen::Index row = 0; row < drive.covariance.rows(); ++row) {
    const Eigen::VectorXd values = drive.covariance.row(row);
    covariance.push_back(number_array({values.data(), static_cast<std::size_t>(values.size())}));
  }
  table.insert("covariance", covariance);
  return table;
}

class FittedReader {
 public:
  FittedReader(const std::string& file, std::optional<Error>& error) : file_(file), error_(error) {}

  FittedDrive read(const toml::table& fitted, DriveModel model) {
    FittedDrive drive;
    drive.model = std::move(model);
    TableReader reader(fitted, "fitted", file_, error_);
    reader.number("lag_s", drive.lag_s);
    reader.number("settling_s", drive.settling_s, 0.0, std::numeric_limits<double>::max());
    reader.number("slow_speed", drive.slow_speed);
    reader.number("cut_off_Hz", drive.cut_off_Hz);
    reader.number("error_rms", drive.error_rms);
    const toml::array* terms = reader.array_of_tables("term");
    if (terms == nullptr) reader.refuse("term", "[fitted] has no terms [[fitted.term]]");
    for (std::size_t i = 0; terms != nullptr && i < terms->size(); ++i)
      read_term(*(*terms)[i].as_table(), drive);
    read_covariance(reader, drive);
    reader.finish();
    return drive;
  }

 private:
  BasisFunction read_function(const toml::table& table, const DriveModel& model) {
    TableReader reader(table, "fitted.term.functions", file_, error_);
    BasisFunction function;
    function.carrier = named<BasisFunction::Carrier>(reader, "carrier", kCarrierNames);
    function.factor = named<BasisFunction::Factor>(reader, "factor", kFactorNames);
    reader.number("first", function.first);
    reader.number("second", function.second);
    reader.integer("index", function.index, -1, 1'000'000);
    reader.finish();
    if (function.factor == BasisFunction::Factor::BalancePower && !(function.second > 1.0))
      reader.refuse("second", "balance-power needs a second of more than 1, the power");
    const bool of_column = function.factor == BasisFunction::Factor::Column ||
                           function.factor == BasisFunction::Factor::ColumnSize;
    if (of_column &&
        (function.index < 0 || static_cast<std::size_t>(function.index) >= model.regressors.size()))
      reader.refuse("index", fmt::format("index {} is none of the {} regressors", function.index,
                                         model.regressors.size()));
    return function;
  }

  template <typename T, std::size_t N>
  static T named(TableReader& reader, std::string_view key, const std::array<std::string_view, N>& names) {
    std::string text;
    reader.text(key, text);
    const std::optional<std::size_t> index = index_of(names, text);
    if (!index) reader.refuse(key, fmt::format("{} must be one of {}", key, fmt::join(names, ", ")));
    return static_cast<T>(index.value_or(0));
  }

  void read_term(const toml::table& table, FittedDrive& drive) {
    TableReader reader(table, "fitted.term", file_, error_);
    FittedTerm term;
    reader.text("name", term.name);
    const auto known = index_of(kDriveTermNames, term.name.substr(0, term.name.find(':')));
    if (!known)
      return reader.refuse("name", fmt::format("no term is called {}; known are {}", term.name,
                                               fmt::join(kDriveTermNames, ", ")));
    term.term = static_cast<DriveTerm>(*known);
    reader.numbers("coefficients", term.coefficients);
    const toml::array* functions = reader.array_of_tables("functions");
    if (functions == nullptr || functions->size() != term.coefficients.size())
      return reader.refuse("functions", fmt::format("{} needs as many functions as coefficients", term.name));
    for (const toml::node& each : *functions)
      term.functions.push_back(read_function(*each.as_table(), drive.model));
    reader.finish();
    drive.terms.push_back(std::move(term));
  }

  void read_covariance(TableReader& reader, FittedDrive& drive) {
    std::vector<std::vector<double>> rows;
    reader.rows_of_numbers("covariance", rows);
    if (rows.empty()) return;
    std::size_t count = 0;
    for (const FittedTerm& term : drive.terms) count += term.coefficients.size();
    if (rows.size() != count ||
        std::ranges::any_of(rows, [&](const auto& row) { return row.size() != count; }))
      return reader.refuse(
          "covariance",
          fmt::format("covariance must have {} rows of {} numbers, one for each coefficient", count, count));
    const auto size = static_cast<Eigen::Index>(count);
    drive.covariance.resize(size, size);
    for (std::size_t i = 0; i < count; ++i)
      drive.covariance.row(static_cast<Eigen::Index>(i)) =
          Eigen::Map<const Eigen::RowVectorXd>(rows[i].data(), size);
  }

  const std::string& file_;
  std::optional<Error>& error_;
};

}  // namespace

Result<FittedDrive> parse_fitted_drive(const std::string& text, const std::string& path) {
  Result<DriveModel> model = parse_drive_model(text, path);
  if (!model) return tl::unexpected(model.error());
  const Result<toml::table> document = parse_toml(text, path);
  if (!document) return tl::unexpected(document.error());
  const toml::table* fitted = (*document)["fitted"].as_table();
  if (fitted == nullptr)
    return failure(fmt::format(
        "{}: the section [fitted] is missing; fit the model to runs and save it under another name: "
        "`clampctl diagnose RUN.csv ... --model {} --save SAVED.toml`",
        path, path));
  std::optional<Error> error;
  FittedDrive drive = FittedReader(path, error).read(*fitted, std::move(*model));
  if (error) return tl::unexpected(*error);
  return drive;
}

Result<FittedDrive> read_fitted_drive(const std::string& path) {
  return read_file(path).and_then([&](const std::string& text) { return parse_fitted_drive(text, path); });
}

std::string format_fitted_drive(const FittedDrive& drive) {
  const DriveModel& model = drive.model;
  toml::table document{{"drive", toml::table{{"name", model.name},
                                             {"kind", model.linear ? "linear" : "rotary"},
                                             {"unit", model.torque_unit}}},
                       {"columns", columns_table(model)},
                       {"model", parts_table(model)},
                       {"data", data_table(model)},
                       {"fitted", fitted_table(drive)}};
  if (!model.regressors.empty()) document.insert("regressors", regressors_table(model));
  if (!model.files.empty()) document.insert("files", files_table(model));
  std::ostringstream text;
  text << "# Written by clampctl diagnose --save; docs/drives.md explains every key.\n" << document << '\n';
  return text.str();
}

}  // namespace clampd
