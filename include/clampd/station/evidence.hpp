#pragma once

#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "clampd/identify/estimate.hpp"
#include "clampd/record/check_record.hpp"
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
};

/// What runs and their joint estimate contribute to the facts of a verdict. Gives what the repeats have in
/// common beside the model, where that can be told.
std::optional<SystematicRecord> add_estimate(const Estimate& joint, const std::vector<RunRecord>& runs,
                                             const EstimateReading& reading, CheckFacts& facts);

/// What the tare's own uncertainty adds to that of theta / theta_nom: all repeats share one tare, so that
/// their scatter does not show it.
ParameterMatrix tare_covariance_normalised(const Estimate& joint, const Tare& tare);

/// Of the parameters with what the tare adds, SI.
ParameterVector sd_with_tare(const Estimate& joint, const Tare& tare);

/// Of the tare's means: force (N), velocity (rad/s).
Eigen::Vector2d offset_sd(const Tare& tare);

}  // namespace clampd
