#pragma once

#include <span>

#include "clampd/identify/estimate.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"
#include "src/identify/joint_normal.hpp"

namespace clampd::identify {

/// What runs show of a known effect that the base model lacks.
struct EffectMisfit {
  bool can_tell = false;
  double p_value = 1.0;  ///< chance that noise alone shows as much of any of them
  /// What the effect does to the estimate of theta / theta_nom, as a covariance about it; zero unless that
  /// chance is below kSystematic.
  ParameterMatrix covariance_normalised = ParameterMatrix::Zero();
};

/// Scores the strengths of all effects (effects_with_strengths) beside a base model that is fitted to the
/// runs by the prediction error method; parameters, initial states and the zeros that the tare has set
/// follow. The strength that shows most is compared with F(1, d), their number counted. Its variance is what
/// the model's noise makes, or the one by which runs differ from what the strength makes of each, where that
/// is larger: of this strength, which few runs tell, together with that of all strengths, which counts as
/// forty degrees of freedom (a moderated variance, Smyth 2004).
///
/// An estimate whose model lacks the strength d is off by what the parameters make of it when they follow:
/// theta - theta_estimated = -I_theta^-1 I_theta,d d, by the information matrix of the estimate's own method.
/// The covariance is the mean of its square over the strengths that may be the cause: each weighs by how
/// likely the runs are with it, an advantage of a tenth of the evidence counting as none, since strengths are
/// linear only while they are small.
///
/// Not to be told (can_tell false): fewer than kFewestRepeats runs, or runs that no base model fits.
///
/// `held`: parameters that did not move; `noise`: by which the estimate's own method weighs the residuals.
EffectMisfit effect_misfit(std::span<const Run> runs, const Estimate& joint, const Held& held,
                           const NoiseLevels& noise);

}  // namespace clampd::identify
