#pragma once

#include <optional>
#include <span>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/views/diagnosis_subject.hpp"
#include "clampd/views/figure.hpp"

namespace clampd::pictures {

/// One view of each manoeuvre, told apart by the names of the runs without their number: the one with the
/// largest residuals before. At most `most`, largest first.
std::vector<const RunView*> representative(std::span<const RunView> views, std::size_t most);

/// Means of y over bins of x that hold equally many values; rows that are not finite are left out.
struct BinnedMeans {
  std::vector<double> x, mean;
  std::vector<double>
      two_sd;  ///< twice the standard deviation of a mean of independent values of unit variance
};
BinnedMeans binned(std::span<const double> x, std::span<const double> y, std::size_t bins);

/// Amplitude of a series at so many periods in a unit of x (rad: `frequency` times x is the phase).
struct Spectrum {
  std::vector<double> frequency, amplitude;
};

/// Of the disturbance torque (N m) over the motor's angle, in periods a revolution: root mean square over the
/// runs. Empty where no run turns the motor far enough.
Spectrum angle_spectrum(std::span<const RunView> views, std::vector<double> RunView::*disturbance_Nm);

/// A run's force and velocity against the simulation, the differences, and the torque error that it needs.
/// Nothing if the view has no simulation. `extended`: there is a model with effects to show beside the base
/// model.
std::optional<report::Figure> run_picture(const RunView& view, bool extended);

/// Mean residual over what it may depend on: in standard deviations of the readings, of a bare drive in its
/// unit of torque.
std::optional<report::Figure> dependence_picture(std::span<const RunView> views, bool extended,
                                                 const DiagnosisSubject& subject);

/// Power of the residuals over frequency; 1 is white noise.
std::optional<report::Figure> residual_spectra_picture(std::span<const RunView> views, bool extended);

/// The error of the torque balance over the motor's position, and its spectra over angle and time.
std::optional<report::Figure> disturbance_picture(std::span<const RunView> views, bool extended,
                                                  const DiagnosisSubject& subject);

/// The candidates of one stage, best first, as bars with the alarm level. At least one.
report::Figure ladder_picture(std::span<const CandidateSummary* const> summaries, double alarm_evidence);

/// Torque, velocity and force of a designed trajectory.
report::Figure trajectory_picture(const Run& trajectory, const DiagnosisSubject& subject);

}  // namespace clampd::pictures
