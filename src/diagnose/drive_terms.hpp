#pragma once

#include <functional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "src/diagnose/drive_rows.hpp"

namespace clampd::drive {

/// A column of the torque balance: one value a row of the given run, the run's number given.
using DriveColumn = std::function<Eigen::VectorXd(const DriveRows&, int)>;

/// A part of the torque balance with its shape settled: linear in the coefficients of its columns.
struct DriveComponent {
  DriveTerm term = DriveTerm::Inertia;
  std::vector<DriveColumn> columns;
  std::vector<double> shape;  ///< of FrictionShape: speed; of Presliding: length; of Cogging: orders
  double alternatives = 1.0;  ///< shapes that it was chosen from
  bool certain = false;       ///< the model file asks for it
};

struct DriveRange {
  double least_position = 0.0, most_position = 0.0;
  double low_speed = 0.0, slow_speed = 0.0, high_speed = 0.0;  ///< a share of 5, 25, 98 % is slower
  double duration_s = 0.0;
};
DriveRange range_of(const DriveData& data);

/// The term in each of the shapes that are worth trying. What has a constant part leaves it out if another
/// one is in the model. None for Cogging, whose orders are scanned.
std::vector<DriveComponent> shapes_of(DriveTerm term, const DriveRange& range, bool constant_in_model);

/// Cosine and sine of the position times the order (1/rev or 1/m). Where the position is integrated from
/// velocity its zero is another one in each run, so that each run has coefficients of its own.
std::vector<DriveColumn> periodic_columns(double order, bool linear, bool absolute, int runs);

/// Orders worth scanning: periods that a run covers and the rows resolve.
std::vector<double> orders_to_scan(const DriveData& data, const DriveRange& range, bool linear);

/// What the technician reads.
std::string_view words_of(DriveTerm term);

}  // namespace clampd::drive
