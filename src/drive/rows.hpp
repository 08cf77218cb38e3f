#pragma once

#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "clampd/base/result.hpp"
#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/record/run.hpp"
#include "src/drive/saturation.hpp"

namespace clampd::drive {

/// Of a run; fewer tell nothing.
inline constexpr std::size_t kLeastSamples = 20;

/// Distance of rows at a cut-off of 1 Hz: neighbours correlate by a tenth.
inline constexpr double kRowsPerCutOff = 0.4;

/// Standard deviation of the rows' filter, a Gaussian with -3 dB at the cut-off.
double gaussian_sd_s(double cut_off_Hz);

/// One run's motion, sample by sample (or average by average).
struct DriveMotion {
  std::vector<double> time_s;  ///< since the run began
  std::vector<double> torque, position, velocity, acceleration;
  std::vector<double> direction;  ///< of the velocity; 0 at standstill
  std::vector<double> travel;     ///< since the last reversal; infinite before the first
  /// The user's own, by DriveModel::regressors; behind them, if it is recorded, the motor's position less the
  /// load's.
  std::vector<std::vector<double>> columns;

  DriveState state(std::size_t i, int run, std::vector<double>& columns_here) const;
  /// Of each sample, what friction that builds up over `length` lacks of its level, half of which is 1. At
  /// standstill it stays as the last motion left it. At the start it is half built up: nobody knows which way
  /// the drive came.
  std::vector<double> lacking_friction(double length) const;
};

/// How the torque follows from its reading: the reading that is `lag_s` older, followed with the time
/// constant `settling_s`, less what saturation takes.
struct Actuation {
  double lag_s = 0.0, settling_s = 0.0;
  SaturationLaw saturation = {};
  auto operator<=>(const Actuation&) const = default;
};

/// The torque balance of one run, low-pass filtered and decimated. What stands on either side of it goes
/// through the same filter, so that the filter changes nothing about the balance (parallel filtering; Gautier
/// 1997).
class DriveRows {
 public:
  std::string name;
  int run = 0;  ///< in the order of the files
  bool heldout = false;
  DriveMotion motion;

  std::size_t size() const { return rows_.size(); }
  /// One value a sample in, one a row out.
  Eigen::VectorXd filtered(std::span<const double> samples) const;
  /// The same, of the samples `lag_s` before each row.
  Eigen::VectorXd filtered(std::span<const double> samples, double lag_s) const;
  /// Torque that acts in each row, filtered.
  Eigen::VectorXd torque_at(const Actuation& actuation) const;

  Eigen::VectorXd time_s, torque, position, velocity, acceleration, direction,
      travel;  ///< filtered, one a row
  double sum_of_squared_weights =
      1.0;  ///< of a row's filter, on average: what white noise of a sample leaves in it

 private:
  friend struct RowsBuilder;
  struct Row {
    double at_s = 0.0;
    std::size_t first = 0;
    std::vector<double> weights;
  };
  std::vector<Row> rows_;
  double filter_sd_s_ = 0.0;
};

/// What the readings themselves say of their noise, independent of any model; standard deviations.
struct ReadingNoise {
  double torque = 0.0;  ///< of a row's torque, by what a sample's torque does beyond the motion's bandwidth
  double acceleration = 0.0;  ///< of a row's acceleration, by the position's (or velocity's) noise and step
};

struct DriveData {
  std::vector<DriveRows> runs;
  double cut_off_Hz = 0.0;        ///< NaN with steady runs
  double sample_s = 0.0;          ///< between two rows of the files, the median; 0 with steady runs
  bool position_absolute = true;  ///< false: integrated from velocity, zero at the start of each run
  bool keeps_reversals = false;   ///< rows in which the drive reverses count too
  double slow_speed = 0.0;        ///< below this a reading counts as standstill
  /// By which the torque seems to act after its reading, as the checks of the readings found; 0: by less than
  /// they tell.
  double delay_s = 0.0;
  double position_step = 0.0;  ///< of the readings of motor and load, the coarser one; 0 without a load's
  ReadingNoise noise;
  RowCount rows;
  std::vector<std::string> notices;
};

/// Motion by local polynomials (no lag, any sampling), rows by a Gaussian low-pass without lag; rows at
/// standstill are left out, since friction there is anything up to its limit. Of `runs`, those from
/// `heldout_from` on are held out; `delay_s` as DriveData has it. Errors: a run too short or without a
/// reading that the model promises, no motion at all.
Result<DriveData> prepare(std::span<const Run> runs, std::size_t heldout_from, const DriveModel& model,
                          double delay_s = 0.0);

}  // namespace clampd::drive
