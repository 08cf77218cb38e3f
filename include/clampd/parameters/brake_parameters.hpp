#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

#include <Eigen/Core>

#include "clampd/base/result.hpp"

namespace clampd {

inline constexpr std::size_t kParameterCount = 7;

/// The identified parameters, in the order of the paper's theta and of every vector and matrix over them.
enum Parameter : std::size_t { k1, k2, TC, Ts0, Tv, mus, ws };

struct ParameterInfo {
  std::string_view name;  ///< as in every file and JSON document
  std::string_view unit;
  std::string_view description;
  double nominal;  ///< the paper's Table I; also the normalisation (11)
  double lower;    ///< physically sensible bounds for an estimate
  double upper;
};

/// THE table of the identified parameters; nothing else lists them.
inline constexpr std::array<ParameterInfo, kParameterCount> kParameterTable{{
    {"k1", "N/rad^3", "stiffness, cubic coefficient", -3.54e-1, -10.0, 10.0},
    {"k2", "N/rad^2", "stiffness, quadratic coefficient", 3.52e1, 1e-1, 1e3},
    {"TC", "N m", "Coulomb friction torque", 7.67e-2, 1e-4, 2.0},
    {"Ts0", "N m", "static friction torque without load", 4.68e-2, 1e-4, 2.0},
    {"Tv", "N m s/rad", "viscous friction coefficient", 4.46e-4, 1e-7, 1e-1},
    {"mus", "N m/N", "load-dependent static friction coefficient", 3.55e-5, 1e-8, 1e-3},
    {"ws", "rad/s", "characteristic velocity of the Stribeck friction", 2.89e1, 1e-1, 1e3},
}};

using ParameterVector = Eigen::Matrix<double, static_cast<int>(kParameterCount), 1>;
using ParameterMatrix =
    Eigen::Matrix<double, static_cast<int>(kParameterCount), static_cast<int>(kParameterCount)>;

/// theta_nom of (11).
ParameterVector nominal_parameters();

/// Index in the table, or nothing if there is no such parameter.
std::optional<std::size_t> find_parameter(std::string_view name);

/// What the paper keeps fixed (Table I): known for the product, not identified.
struct FixedParameters {
  double inertia_kg_m2 = 2.91e-4;  ///< J
  double ratio_m_rad = 2.63e-5;    ///< N
};

/// A whole brake: what is identified and what is fixed.
struct BrakeParameters {
  ParameterVector theta = nominal_parameters();
  FixedParameters fixed;
};

/// Reads the tables [parameters] (k1 ... ws, SI) or [parameters_normalised] (times nominal), and [fixed]
/// (inertia_kg_m2, ratio_m_rad) of a TOML file; what is not named stays nominal. Other tables are ignored,
/// unknown keys inside of these are errors, as are values outside of the parameter table's bounds.
Result<BrakeParameters> read_brake_parameters(const std::string& path);

/// The same from text; `path` stands for the file in messages.
Result<BrakeParameters> parse_brake_parameters(std::string_view text, const std::string& path);

}  // namespace clampd
