#pragma once

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/diagnose/drive_model.hpp"
#include "src/diagnose/drive_regression.hpp"
#include "src/diagnose/drive_search.hpp"
#include "src/diagnose/drive_terms.hpp"

namespace clampd::drive {

std::string_view name_of(DriveTerm term);

/// Of a torque per velocity, acceleration and so on.
struct Units {
  std::string torque, position, velocity, per_velocity, per_acceleration, per_velocity_squared, order;

  explicit Units(const DriveModel& model)
      : torque(model.torque_unit),
        position(model.position_unit()),
        velocity(position + "/s"),
        per_velocity(torque == "A" ? "A s/" + position : torque + " s/" + position),
        per_acceleration(torque == "N m" ? "kg m^2"
                         : torque == "N" ? "kg"
                                         : "A s^2/" + position),
        per_velocity_squared(torque + " s^2/" + position + "^2"),
        order(model.linear ? "1/m" : "1/rev") {}
};

/// Where a component's coefficients stand in the model's.
struct Layout {
  std::vector<DriveComponent> components;
  std::vector<Eigen::Index> first;
  Eigen::Index count = 0;

  explicit Layout(std::vector<DriveComponent> all) : components(std::move(all)) {
    for (const DriveComponent& component : components) {
      first.push_back(count);
      count += static_cast<Eigen::Index>(component.columns.size());
    }
  }
  /// -1 if absent.
  Eigen::Index at(DriveTerm term) const {
    for (std::size_t i = 0; i < components.size(); ++i)
      if (components[i].term == term) return first[i];
    return -1;
  }
};

/// A model fitted to all rows.
struct Fitted {
  Layout layout;
  Regression regression;
  Eigen::MatrixXd over_cells;  ///< covariance by parts of the operating range; empty if there are too few
  Eigen::MatrixXd columns;

  double variance_of(const Eigen::VectorXd& weights) const {
    const double over_time = weights.dot(regression.jackknife * weights);
    return over_cells.size() == 0 ? over_time : std::max(over_time, weights.dot(over_cells * weights));
  }

  /// Sum of factor times coefficient, with its standard deviation
  EstimatedParameter combined(std::string name, std::string unit,
                              std::initializer_list<std::pair<Eigen::Index, double>> terms,
                              double known = 0.0) const {
    Eigen::VectorXd weights = Eigen::VectorXd::Zero(layout.count);
    for (const auto& [index, factor] : terms)
      if (index >= 0) weights[index] += factor;
    const double variance = variance_of(weights);
    return {std::move(name), std::move(unit), known + weights.dot(regression.coefficients),
            variance > 0.0 ? std::sqrt(variance) : std::numeric_limits<double>::quiet_NaN()};
  }
};

Fitted fitted(const DriveFit& fit, std::vector<DriveComponent> components);

/// Of the torque of all rows, what the model leaves.
double relative_error(const Fitted& model, const DriveFit& fit);

/// Inertia, viscous and Coulomb friction, as far as the drive's model has them.
std::vector<EstimatedParameter> base_parameters(const Fitted& model, const DriveModel& drive,
                                                const Units& units);

std::vector<EstimatedParameter> effect_parameters(const DriveComponent& component, const Fitted& model,
                                                  const DriveModel& drive, const Units& units);

}  // namespace clampd::drive
