#pragma once

#include <initializer_list>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "clampd/diagnose/diagnosis.hpp"
#include "src/drive/selection.hpp"

namespace clampd::drive {

/// Of a torque per velocity, acceleration and so on.
struct Units {
  std::string torque, position, velocity, per_velocity, per_acceleration, per_velocity_squared, order;

  explicit Units(const DriveModel& model)
      : torque(model.torque_unit),
        position(model.position_unit()),
        velocity(position + "/s"),
        per_velocity(torque + " s/" + position),
        per_acceleration(torque == "N m" ? "kg m^2"
                         : torque == "N" ? "kg"
                                         : torque + " s^2/" + position),
        per_velocity_squared(torque + " s^2/" + position + "^2"),
        order(model.linear ? "1/m" : "1/rev") {}
};

/// A fitted model with the uncertainty of its coefficients.
class Estimate {
 public:
  Estimate(const Design& design, const TorqueModel& model, const DriveModel& drive);

  /// Inertia, viscous and Coulomb friction, as far as the drive's model has them.
  std::vector<EstimatedParameter> base_parameters() const;
  /// And those of these parts, as "PART.PARAMETER".
  std::vector<EstimatedParameter> base_parameters_with(const std::vector<Variant>& parts) const;
  std::vector<EstimatedParameter> effect_parameters(const Variant& variant) const;
  const Eigen::MatrixXd& covariance() const { return covariance_; }
  /// First coefficient of the term; -1: it has none.
  Eigen::Index at(DriveTerm term) const;
  EstimatedParameter combined(std::string name, std::string unit,
                              std::initializer_list<std::pair<Eigen::Index, double>> terms,
                              double known = 0.0) const;

 private:
  std::vector<EstimatedParameter> cogging(const Variant& variant, Eigen::Index at) const;
  std::vector<EstimatedParameter> asymmetry(const Variant& variant, Eigen::Index at) const;
  std::vector<EstimatedParameter> stribeck(const Variant& variant, Eigen::Index first) const;
  std::vector<EstimatedParameter> power_law(const Variant& variant, Eigen::Index first) const;
  std::vector<EstimatedParameter> stiffening_spring(Eigen::Index first, double unit) const;
  std::vector<EstimatedParameter> load_position(const Variant& variant, Eigen::Index first) const;
  std::vector<EstimatedParameter> drift(const Variant& variant, Eigen::Index first) const;
  std::vector<EstimatedParameter> gravity(const Variant& variant, Eigen::Index first) const;
  std::vector<EstimatedParameter> wave(const Variant& variant, Eigen::Index first,
                                       const std::string& unit) const;
  /// One coefficient of a term, times a factor.
  EstimatedParameter single(Eigen::Index first, std::string name, const std::string& unit,
                            Eigen::Index offset = 0, double factor = 1.0) const;
  EstimatedParameter shape_of(const Variant& variant, std::string name, const std::string& unit) const;
  EstimatedParameter amplitude(std::string name, Eigen::Index first, Eigen::Index count, Eigen::Index stride,
                               Eigen::Index owners) const;

  const TorqueModel& model_;
  const DriveModel& drive_;
  Units units_;
  Eigen::MatrixXd covariance_;
};

}  // namespace clampd::drive
