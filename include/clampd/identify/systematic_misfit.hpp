#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "clampd/identify/estimate.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// A systematic residual counts from this chance on that noise alone shows as much.
inline constexpr double kSystematic = 1e-3;

/// What the runs of a brake show that the model lacks: what repeats of one motion have in common, and what a
/// known effect would make of all of them.
struct SystematicMisfit {
  bool can_tell = false;    ///< by one test at least
  double p_value = 1.0;     ///< chance that noise alone shows as much by one of the tests
  double over_noise = 0.0;  ///< rms of what they have in common over that of one repeat's noise, in stretches
                            ///< of kBlock_rows
  /// What it adds to the covariance of theta / theta_nom, of the tests that are significant.
  ParameterMatrix covariance_normalised = ParameterMatrix::Zero();

  bool is_significant() const { return can_tell && p_value < kSystematic; }
  /// The most that it may move a parameter, over the standard deviation of theta / theta_nom without it.
  double moved_sd(const ParameterVector& sd_normalised) const;
  /// Whether its covariance is added to that of the estimate: significant, and more than those deviations.
  bool counts(const ParameterVector& sd_normalised) const {
    return is_significant() && moved_sd(sd_normalised) > 1.0;
  }
};

/// Fewer repeats say too little about their own scatter.
inline constexpr std::size_t kFewestRepeats = 4;

/// Two tests of a joint estimate of the base model; the smaller chance counts, times their number.
///
/// *What repeats have in common*, whatever it is: of the residuals of a simulation by the recorded torque
/// after the output error method, and after the prediction error method the innovations, by the estimate's
/// noise of the torque. Each repeat's residuals are summed over blocks of neighbouring rows, what the
/// parameters, the initial state and a wrong tare could answer taken off; then R |mean|^2 over the trace of
/// the repeats' own covariance is compared with F(h, (R - 1) h) (Dempster, A high dimensional two sample
/// significance test, 1958, for one sample), h by the covariance's unbiased traces (Srivastava, Fujikoshi,
/// 2006). It takes the noise from the repeats alone: neither its level nor its autocorrelation, which the
/// controller feeds through the motion, is presumed.
/// Its covariance is the jackknife over stretches of the trajectory (Tukey 1958; HC3 of MacKinnon and White
/// 1985, of clusters): how far theta would move if one stretch of the repeats' mean residual were left out.
/// The parts of the trajectory then contradict each other about theta. What all of them answer by the same
/// wrong theta is not seen, so it bounds the error from below.
///
/// *What a known effect makes of the runs* (src/identify/effect_misfit.hpp), which sees smaller effects and
/// knows how far each moves the parameters; it knows nothing of what is not in the catalogue.
///
/// Not to be told (can_tell false): fewer than kFewestRepeats runs, an estimate that has not converged or
/// with effects beside the base model, a model that leaves all bounds. The first test needs repeats of the
/// same length, the second one runs that the prediction error method fits.
///
/// `motions`: which runs repeat one motion, a number for each; those like the first are the repeats. Empty:
/// all are. The estimate is of all runs.
SystematicMisfit systematic_misfit(std::span<const Run> runs, const Estimate& joint,
                                   std::span<const std::uint8_t> motions = {});

}  // namespace clampd
