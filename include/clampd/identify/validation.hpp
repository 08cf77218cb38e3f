#pragma once

#include <span>

#include "clampd/base/result.hpp"
#include "clampd/brake/simulation.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// Whether runs can be identified from: two rows or more of finite numbers in all columns, time increasing
/// without leaps. The error says which run, what and where.
Result<void> check_runs(std::span<const Run> runs);

/// Whiteness of a residual series.
struct Portmanteau {
  double statistic =
      0.0;  ///< Ljung-Box over `lags` autocorrelations; chi-square with `lags` degrees if white
  int lags = 0;
  double p_value = 1.0;
};

/// Ljung-Box of autocorrelations 1 ... lags (fewer for short series), the mean removed.
Portmanteau portmanteau(std::span<const double> residuals, int lags = 20);

/// How well a model explains one channel of a run.
struct ChannelMisfit {
  double rms = 0.0;  ///< of the residuals, in the channel's unit
  double chi_square_per_sample =
      0.0;  ///< mean squared residual over the noise variance; 1 if only noise is left
  Portmanteau whiteness;
};

struct RunMisfit {
  bool simulated = false;  ///< false: the simulation diverged, and the rest is meaningless
  ChannelMisfit force;
  ChannelMisfit velocity;
};

/// Residuals of a run against the model's open-loop simulation. Torque noise makes them coloured and larger
/// than the sensors' noise even for a perfect model, so a large figure calls for a closer look, not yet for
/// another model.
RunMisfit assess_run(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                     const SensorNoise& noise);

}  // namespace clampd
