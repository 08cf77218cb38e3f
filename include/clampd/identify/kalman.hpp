#pragma once

#include <vector>

#include "clampd/brake/integrator.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// A signal with its standard deviation, row by row. Bands are of the signal itself, without the sensor's
/// noise.
struct Band {
  std::vector<double> mean;
  std::vector<double> sd;
};

struct BandedRun {
  Band position_rad;
  Band velocity_rad_s;
  Band force_N;
};

/// Three views of a run by the extended Kalman filter (15)-(19), for given parameters, initial state and
/// noise. Rows as in the run; NaN from where the filter diverged on.
struct KalmanViews {
  BandedRun one_step;  ///< row k from the readings before row k
  BandedRun filtered;  ///< row k from the readings up to row k
  BandedRun smoothed;  ///< row k from all readings (Rauch-Tung-Striebel)
};

KalmanViews kalman_views(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                         const NoiseLevels& noise);

/// The two readings of Procedure 3's cost, half the sum of e' S^-1 e + log det S over the rows.
struct PredictionCosts {
  double innovations;  ///< e(k) = y(k) - h(x(k|k-1)): minus the log-likelihood, less a constant
  /// As printed, e(k) = y(k) - h(x(k|k)), an output that has already been corrected by the reading it is
  /// compared with. For comparison only: it favours filters that follow the readings, with too much torque
  /// noise and too little noise of the sensors.
  double as_printed;
};

/// Infinite if the filter diverges.
PredictionCosts prediction_costs(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                                 const NoiseLevels& noise);

/// The open-loop simulation from `initial`, with the band that the torque's noise leaves it.
BandedRun free_run(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                   const NoiseLevels& noise);

}  // namespace clampd
