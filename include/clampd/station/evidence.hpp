#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "clampd/identify/estimate.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/sheet/evaluation.hpp"
#include "clampd/sheet/sheet.hpp"
#include "clampd/station/run_collector.hpp"
#include "clampd/station/stopping.hpp"
#include "clampd/station/verdict.hpp"

namespace clampd {

/// What to do where the output error method does not get far.
inline constexpr std::string_view kUsePredictionErrors = "set method = \"pem\" under [check]";

/// What an estimate is read with.
struct EstimateReading {
  BrakeParameters model;  ///< the nominal brake
  Tare tare;
  double torque_noise_Nm = 0.0;            ///< sd per sample of the torque reading, which no fit can follow
  bool is_by_output_errors = true;         ///< the output error method was asked for
  double guard_band_k = 0.0;               ///< of the limits
  const Sheet* sheet = nullptr;            ///< what is asked of the brake beside its parameters
  const StoppingRule* stopping = nullptr;  ///< nullptr: a fixed number of repeats
  std::optional<double> found_rad = {};    ///< the encoder's reading when the check found the brake
};

/// What runs and their joint estimate contribute to the facts of a verdict. Gives what the repeats have in
/// common beside the model, where that can be told.
std::optional<SystematicRecord> add_estimate(const Estimate& joint, const std::vector<RunRecord>& records,
                                             const EstimateReading& reading, CheckFacts& facts);

/// What the tare's own uncertainty adds to that of theta / theta_nom: all repeats share one tare, so that
/// their scatter does not show it.
ParameterMatrix tare_covariance_normalised(const Estimate& joint, const Tare& tare);

/// Of a check: the estimate with what is `added` to its covariance, what the encoder tells of the contact
/// point, and what the tare adds to that, which it shares with the parameters.
Posterior posterior_of_check(const Estimate& joint, const ParameterMatrix& added, std::span<const Run> runs,
                             const Tare& tare, std::optional<double> found_rad);

/// Of the parameters with what the tare adds, SI.
ParameterVector sd_with_tare(const Estimate& joint, const Tare& tare);

/// Of the tare's means: force (N), velocity (rad/s).
Eigen::Vector2d offset_sd(const Tare& tare);

}  // namespace clampd
