#pragma once

#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "clampd/base/result.hpp"
#include "clampd/diagnose/drive_model.hpp"
#include "clampd/record/run.hpp"

namespace clampd::drive {

/// One run's motion, sample by sample.
struct DriveMotion {
  std::vector<double> time_s, torque, position, velocity, acceleration;
  std::vector<double> sign;    ///< of the velocity; 0 at standstill
  std::vector<double> travel;  ///< since the last reversal; infinite before the first
};

/// The torque balance of one run, low-pass filtered and decimated. What stands on either side of it goes
/// through the same filter, so that the filter changes nothing about the balance (parallel filtering; Gautier
/// 1997).
class DriveRows {
 public:
  std::string name;
  DriveMotion motion;

  std::size_t size() const { return rows_.size(); }
  /// One value a sample in, one a row out.
  Eigen::VectorXd filtered(std::span<const double> samples) const;

  Eigen::VectorXd time_s, torque, position, velocity, acceleration, sign;  ///< filtered, one a row

 private:
  friend struct RowsBuilder;
  struct Row {
    std::size_t first = 0;
    std::vector<double> weights;
  };
  std::vector<Row> rows_;
};

struct DriveData {
  std::vector<DriveRows> runs;
  double cut_off_Hz = 0.0;        ///< NaN with steady runs
  bool position_absolute = true;  ///< false: integrated from velocity, zero at the start of each run
  std::vector<std::string> notices;
};

/// Motion by local polynomials (no lag, any sampling), rows by a Gaussian low-pass without lag; rows at
/// standstill are left out, since friction there is anything up to its limit. `cut_off_Hz` overrides the
/// model's. Errors: a run too short or without a reading that the model promises, no motion at all.
Result<DriveData> prepare(std::span<const Run> runs, const DriveModel& model, double cut_off_Hz);

}  // namespace clampd::drive
