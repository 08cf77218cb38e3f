#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <sstream>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "clampd/drive/model.hpp"
#include "clampd/record/file.hpp"
#include "src/drive/strict_reader.hpp"

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

class FittedReader : public drive::StrictReader {
 public:
  using StrictReader::StrictReader;

  FittedDrive read(DriveModel model) {
    FittedDrive drive;
    drive.model = std::move(model);
    const toml::table* fitted = document_["fitted"].as_table();
    if (fitted == nullptr) {
      error_ = Error{fmt::format(
          "{}: the section [fitted] is missing; fit the model to runs and save it under another name: "
          "`clampctl diagnose RUN.csv ... --model {} --save SAVED.toml`",
          path_, path_)};
      return drive;
    }
    drive.lag_s = number(*fitted, "lag_s", 0.0);
    drive.settling_s = number(*fitted, "settling_s", 0.0);
    if (drive.settling_s < 0.0) refuse(*fitted->get("settling_s"), "settling_s must not be negative");
    drive.slow_speed = number(*fitted, "slow_speed", 0.0);
    drive.cut_off_Hz = number(*fitted, "cut_off_Hz", drive.cut_off_Hz);
    drive.error_rms = number(*fitted, "error_rms", drive.error_rms);
    const toml::node* terms = fitted->get("term");
    if (terms == nullptr || !terms->is_array() || terms->as_array()->empty()) {
      refuse(*fitted, "[fitted] has no terms [[fitted.term]]");
      return drive;
    }
    for (const toml::node& term : *terms->as_array()) read_term(term, drive);
    read_covariance(*fitted, drive);
    return drive;
  }

 private:
  double number(const toml::table& table, std::string_view key, double otherwise) {
    const toml::node* node = table.get(key);
    if (node == nullptr) return otherwise;
    const double value = node->is_number() ? node->value_or(0.0) : std::numeric_limits<double>::quiet_NaN();
    if (!std::isfinite(value)) refuse(*node, fmt::format("{} must be a finite number", key));
    return value;
  }

  BasisFunction function_of(const toml::node& node, const DriveModel& model) {
    BasisFunction function;
    const toml::table* table = node.as_table();
    if (table == nullptr) {
      refuse(node, "a function must be a table with carrier and factor");
      return function;
    }
    const auto carrier = index_of(kCarrierNames, (*table)["carrier"].value_or(std::string_view{}));
    const auto factor = index_of(kFactorNames, (*table)["factor"].value_or(std::string_view{}));
    if (!carrier) refuse(node, fmt::format("carrier must be one of {}", fmt::join(kCarrierNames, ", ")));
    if (!factor) refuse(node, fmt::format("factor must be one of {}", fmt::join(kFactorNames, ", ")));
    if (!carrier || !factor) return function;
    function.carrier = static_cast<BasisFunction::Carrier>(*carrier);
    function.factor = static_cast<BasisFunction::Factor>(*factor);
    function.first = number(*table, "first", 0.0);
    function.second = number(*table, "second", 1.0);
    function.index = static_cast<int>(std::clamp(number(*table, "index", -1.0), -1.0, 1e6));
    if (function.factor == BasisFunction::Factor::BalancePower && !(function.second > 1.0))
      refuse(node, "balance-power needs a second of more than 1, the power");
    const bool of_column = function.factor == BasisFunction::Factor::Column ||
                           function.factor == BasisFunction::Factor::ColumnSize;
    if (of_column &&
        (function.index < 0 || static_cast<std::size_t>(function.index) >= model.regressors.size()))
      refuse(node,
             fmt::format("index {} is none of the {} regressors", function.index, model.regressors.size()));
    return function;
  }

  void read_term(const toml::node& node, FittedDrive& drive) {
    const toml::table* table = node.as_table();
    const auto text = table == nullptr ? std::nullopt : (*table)["name"].value<std::string>();
    if (!text) return refuse(node, "a term needs a name");
    FittedTerm term;
    term.name = *text;
    const auto known = index_of(kDriveTermNames, term.name.substr(0, term.name.find(':')));
    if (!known)
      return refuse(node, fmt::format("no term is called {}; known are {}", term.name,
                                      fmt::join(kDriveTermNames, ", ")));
    term.term = static_cast<DriveTerm>(*known);
    const toml::array* functions = (*table)["functions"].as_array();
    const toml::array* coefficients = (*table)["coefficients"].as_array();
    if (functions == nullptr || coefficients == nullptr || functions->size() != coefficients->size())
      return refuse(node, fmt::format("{} needs as many functions as coefficients", term.name));
    for (const toml::node& each : *functions) term.functions.push_back(function_of(each, drive.model));
    for (const toml::node& each : *coefficients) {
      const double value = each.is_number() ? each.value_or(0.0) : std::numeric_limits<double>::quiet_NaN();
      if (!std::isfinite(value)) refuse(each, "a coefficient must be a finite number");
      term.coefficients.push_back(value);
    }
    drive.terms.push_back(std::move(term));
  }

  void read_covariance(const toml::table& fitted, FittedDrive& drive) {
    const toml::array* rows = fitted["covariance"].as_array();
    if (rows == nullptr || rows->empty()) return;
    std::size_t count = 0;
    for (const FittedTerm& term : drive.terms) count += term.coefficients.size();
    bool square = rows->size() == count;
    drive.covariance.setZero(static_cast<Eigen::Index>(count), static_cast<Eigen::Index>(count));
    for (std::size_t i = 0; square && i < count; ++i) {
      const toml::array* row = (*rows)[i].as_array();
      square = row != nullptr && row->size() == count;
      for (std::size_t j = 0; square && j < count; ++j)
        drive.covariance(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) =
            (*row)[j].value_or(0.0);
    }
    if (!square)
      refuse(*rows, fmt::format("covariance must have {} rows of {} numbers, one for each coefficient", count,
                                count));
  }
};

}  // namespace

Result<FittedDrive> parse_fitted_drive(const std::string& text, const std::string& path) {
  Result<DriveModel> model = parse_drive_model(text, path);
  if (!model) return tl::unexpected(model.error());
  const toml::table document = toml::parse(text, path);  // it has just been parsed
  FittedReader reader(document, path);
  FittedDrive drive = reader.read(std::move(*model));
  if (reader.error()) return tl::unexpected(*reader.error());
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
