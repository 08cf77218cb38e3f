#include "src/diagnose/drive_fitted.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"

namespace clampd::drive {

namespace {


}  // namespace

std::string_view name_of(DriveTerm term) {
  return kDriveTermNames[static_cast<std::size_t>(term)];
}

Fitted fitted(const DriveFit& fit, std::vector<DriveComponent> components) {
  Fitted result{Layout(std::move(components)), {}, {}, {}};
  result.columns = fit.columns(result.layout.components);
  result.regression = regress(result.columns, fit.target(), fit.blocks());
  // A model that fits one part of the range better than another is known no better than they agree.
  if (fit.by_conditions()) result.over_cells = regress(result.columns, fit.target(), fit.cells()).clustered;
  return result;
}

double relative_error(const Fitted& model, const DriveFit& fit) {
  double square = 0.0;
  for (const DriveRows& run : fit.data().runs) square += run.torque.squaredNorm();
  return std::sqrt(model.regression.residual_square / square);
}

std::vector<EstimatedParameter> base_parameters(const Fitted& model, const DriveModel& drive,
                                                const Units& units) {
  std::vector<EstimatedParameter> parameters;
  const auto add = [&](DriveTerm term, const std::string& unit) {
    if (drive.part(term).use == PartUse::Fixed)
      parameters.push_back({std::string(name_of(term)), unit, drive.part(term).value, kNaN});
    else if (model.layout.at(term) >= 0)
      parameters.push_back(model.combined(std::string(name_of(term)), unit, {{model.layout.at(term), 1.0}}));
  };
  add(DriveTerm::Inertia, units.per_acceleration);
  add(DriveTerm::Viscous, units.per_velocity);
  add(DriveTerm::Coulomb, units.torque);
  return parameters;
}

std::vector<EstimatedParameter> effect_parameters(const DriveComponent& component, const Fitted& model,
                                                  const DriveModel& drive, const Units& units) {
  const Eigen::Index at = model.layout.at(component.term);
  const auto known = [&](DriveTerm term) {
    return drive.part(term).use == PartUse::Fixed ? drive.part(term).value : 0.0;
  };
  const auto one = [&](std::string name, std::string unit) {
    return std::vector<EstimatedParameter>{model.combined(std::move(name), std::move(unit), {{at, 1.0}})};
  };
  switch (component.term) {
    case DriveTerm::Inertia:
    case DriveTerm::Viscous:
    case DriveTerm::Coulomb:
      break;
    case DriveTerm::TorqueOffset:
      return one("offset", units.torque);
    case DriveTerm::FrictionAsymmetry: {
      const bool own_offset = component.columns.size() == 2;
      const Eigen::Index load = model.layout.at(DriveTerm::LoadPosition);
      const Eigen::Index constant = own_offset  ? at
                                    : load >= 0 ? -1
                                                : model.layout.at(DriveTerm::TorqueOffset);
      const Eigen::Index slope = own_offset ? at + 1 : at;
      const Eigen::Index viscous = model.layout.at(DriveTerm::Viscous);
      const Eigen::Index coulomb = model.layout.at(DriveTerm::Coulomb);
      const double viscous_known = known(DriveTerm::Viscous);
      const double coulomb_known = known(DriveTerm::Coulomb);
      return {
          model.combined("viscous-forward", units.per_velocity, {{viscous, 1.0}, {slope, 1.0}},
                         viscous_known),
          model.combined("coulomb-forward", units.torque, {{coulomb, 1.0}, {constant, 1.0}}, coulomb_known),
          model.combined("viscous-backward", units.per_velocity, {{viscous, 1.0}, {slope, -1.0}},
                         viscous_known),
          model.combined("coulomb-backward", units.torque, {{coulomb, 1.0}, {constant, -1.0}},
                         coulomb_known)};
    }
    case DriveTerm::QuadraticDrag:
      return one("drag", units.per_velocity_squared);
    case DriveTerm::FrictionShape: {
      auto parameters = one("rise", units.torque);
      parameters.push_back({"speed", units.velocity, component.shape.front(), kNaN});
      return parameters;
    }
    case DriveTerm::Presliding: {
      auto parameters = one("level", units.torque);
      parameters.push_back({"length", units.position, component.shape.front(), kNaN});
      return parameters;
    }
    case DriveTerm::Cogging: {
      std::vector<EstimatedParameter> parameters;
      const std::size_t each = component.columns.size() / component.shape.size();
      for (std::size_t k = 0; k < component.shape.size(); ++k) {
        const std::string number = fmt::format("-{}", k + 1);
        const Eigen::Index first = at + static_cast<Eigen::Index>(k * each);
        parameters.push_back({"order" + number, units.order, component.shape[k], kNaN});
        // Of the runs together, where each has its own phase.
        double square = 0.0;
        double noise = 0.0;
        for (std::size_t j = 0; j < each; ++j) {
          const Eigen::Index index = first + static_cast<Eigen::Index>(j);
          const double value = model.regression.coefficients[index];
          square += value * value * 2.0 / static_cast<double>(each);
          noise += value * value * model.variance_of(Eigen::VectorXd::Unit(model.layout.count, index)) * 4.0 /
                   static_cast<double>(each * each);
        }
        const double amplitude = std::sqrt(square);
        parameters.push_back({"amplitude" + number, units.torque, amplitude,
                              amplitude > 0.0 ? std::sqrt(noise) / amplitude : kNaN});
        if (each != 2) continue;
        parameters.push_back(model.combined("cosine" + number, units.torque, {{first, 1.0}}));
        parameters.push_back(model.combined("sine" + number, units.torque, {{first + 1, 1.0}}));
      }
      return parameters;
    }
    case DriveTerm::FrictionPosition:
    case DriveTerm::LoadPosition: {
      // Legendre polynomials of the position over the range of the runs.
      const bool constant = component.columns.size() == 3;
      const Eigen::Index slope = constant ? at + 1 : at;
      std::vector<EstimatedParameter> parameters{
          model.combined("slope", units.torque, {{slope, 1.0}}),
          model.combined("curvature", units.torque, {{slope + 1, 1.0}})};
      if (constant) parameters.push_back(model.combined("mean", units.torque, {{at, 1.0}}));
      return parameters;
    }
    case DriveTerm::FrictionDrift:
      return one("change-per-run", units.torque);
  }
  return {};
}

}  // namespace clampd::drive
