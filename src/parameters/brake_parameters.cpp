#include "clampd/parameters/brake_parameters.hpp"

#include <cmath>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "clampd/base/toml_location.hpp"
#include "clampd/record/file.hpp"

namespace clampd {

namespace {

Result<double> finite_number(const std::string& path, std::string_view key, const toml::node& node) {
  const auto value = node.value<double>();
  if (!value || !std::isfinite(*value))
    return failure(fmt::format("{}: {} must be a finite number", location_of(path, node), key));
  return *value;
}

/// Shared by [parameters] (unit: 1) and [parameters_normalised] (unit: the nominal value).
Result<void> read_parameters(const std::string& path, std::string_view table_name, const toml::table& table,
                             bool normalised, ParameterVector& theta) {
  for (const auto& [key, node] : table) {
    const auto index = find_parameter(key.str());
    if (!index) {
      std::string known;
      for (const auto& info : kParameterTable) known += (known.empty() ? "" : ", ") + std::string(info.name);
      return failure(fmt::format("{}: [{}] has no parameter \"{}\"; known are {}", location_of(path, node), table_name,
                                 key.str(), known));
    }
    const ParameterInfo& info = kParameterTable[*index];
    const auto number = finite_number(path, key.str(), node);
    if (!number) return tl::unexpected(number.error());
    const double value = normalised ? *number * info.nominal : *number;
    if (value < info.lower || value > info.upper)
      return failure(fmt::format("{}: {} = {} {} is outside of {} ... {}", location_of(path, node), info.name, value,
                                 info.unit, info.lower, info.upper));
    theta[static_cast<Eigen::Index>(*index)] = value;
  }
  return {};
}

Result<void> read_fixed(const std::string& path, const toml::table& table, FixedParameters& fixed) {
  for (const auto& [key, node] : table) {
    double* target = nullptr;
    if (key.str() == "inertia_kg_m2") target = &fixed.inertia_kg_m2;
    if (key.str() == "ratio_m_rad") target = &fixed.ratio_m_rad;
    if (target == nullptr)
      return failure(fmt::format("{}: [fixed] has no key \"{}\"; known are inertia_kg_m2, ratio_m_rad",
                                 location_of(path, node), key.str()));
    const auto number = finite_number(path, key.str(), node);
    if (!number) return tl::unexpected(number.error());
    if (*number <= 0.0) return failure(fmt::format("{}: {} must be positive", location_of(path, node), key.str()));
    *target = *number;
  }
  return {};
}

}  // namespace

ParameterVector nominal_parameters() {
  ParameterVector theta;
  for (std::size_t i = 0; i < kParameterCount; ++i)
    theta[static_cast<Eigen::Index>(i)] = kParameterTable[i].nominal;
  return theta;
}

std::optional<std::size_t> find_parameter(std::string_view name) {
  for (std::size_t i = 0; i < kParameterCount; ++i)
    if (kParameterTable[i].name == name) return i;
  return std::nullopt;
}

Result<BrakeParameters> read_brake_parameters(const std::string& path) {
  const auto text = read_file(path);
  if (!text) return tl::unexpected(text.error());
  return parse_brake_parameters(*text, path);
}

Result<BrakeParameters> parse_brake_parameters(std::string_view text, const std::string& path) {
  toml::table document;
  try {
    document = toml::parse(text, path);
  } catch (const toml::parse_error& error) {
    const auto where = error.source().begin;
    return failure(
        fmt::format("{}:{}:{}: not valid TOML: {}", path, where.line, where.column, error.description()));
  }

  BrakeParameters parameters;
  const auto table_of = [&](std::string_view name) -> Result<const toml::table*> {
    const toml::node* node = document.get(name);
    if (node == nullptr) return nullptr;
    if (!node->is_table())
      return failure(fmt::format("{}: {} must be a table [{}]", location_of(path, *node), name, name));
    return node->as_table();
  };
  const auto physical = table_of("parameters");
  if (!physical) return tl::unexpected(physical.error());
  const auto normalised = table_of("parameters_normalised");
  if (!normalised) return tl::unexpected(normalised.error());
  const auto fixed = table_of("fixed");
  if (!fixed) return tl::unexpected(fixed.error());

  if (*physical != nullptr && *normalised != nullptr) {
    for (const auto& [key, node] : **normalised)
      if ((*physical)->contains(key.str()))
        return failure(fmt::format("{}: {} is given in [parameters] and in [parameters_normalised]; keep one",
                                   location_of(path, node), key.str()));
  }
  if (*physical != nullptr)
    if (auto read = read_parameters(path, "parameters", **physical, false, parameters.theta); !read)
      return tl::unexpected(read.error());
  if (*normalised != nullptr)
    if (auto read = read_parameters(path, "parameters_normalised", **normalised, true, parameters.theta);
        !read)
      return tl::unexpected(read.error());
  if (*fixed != nullptr)
    if (auto read = read_fixed(path, **fixed, parameters.fixed); !read) return tl::unexpected(read.error());
  return parameters;
}

}  // namespace clampd
