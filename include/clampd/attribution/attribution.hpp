#pragma once

#include <string>
#include <vector>

#include "clampd/attribution/crossed_effects.hpp"
#include "clampd/attribution/line_table.hpp"

namespace clampd::attribution {

/// Something that the spread of the line does not explain.
struct Finding {
  enum class Kind {
    StationStep,   ///< a station's readings changed between two periods, and stayed there
    StationDrift,  ///< they went on in one direction
    StationApart,  ///< a station differs from the others by more than stations do
    BatchApart,    ///< a batch differs from the others by more than batches do
  };
  Kind kind = Kind::StationStep;
  int number = 0;     ///< of the station or batch
  int period = 0;     ///< of a step: the first period after it
  double size = 0.0;  ///< of the step, of the drift from the first period to the last, of the difference
  double sd = 0.0;
  double p = 1.0;  ///< probability of as much without a cause, for this one test
};

/// What a station's level is known by.
struct StationLevel {
  double level = 0.0;  ///< against the mean of the stations
  double sd = 0.0;
  /// The share of the stations' variance that the data tell of: 0 nothing, 1 all.
  double reliability = 0.0;
};

struct ParameterAttribution {
  std::string name;
  std::string unit;
  bool converged = false;
  double mean = 0.0;
  double identification = 0.0;  ///< root mean square of the standard deviations that identification reported
  Deviations deviations;
  Components components;
  std::vector<StationLevel> stations;
  std::vector<Finding> findings;  ///< the strongest first
  /// Stations explain a spread as well as batches do: `deviations.station` is as large as it can be then.
  bool confounded = false;
  /// So many brakes, checked at two stations each, would tell the stations apart; 0 where it is known
  /// already.
  int brakes_needed = 0;
};

struct AttributionOptions {
  double false_alarms = 0.01;  ///< the probability that anything is found on a line where there is nothing
  int threads = 0;             ///< 0: as many as there are processors
};

struct LineAttribution {
  std::vector<ParameterAttribution> parameters;
  std::vector<bool>
      separable;  ///< per station: its level is known well enough, in all parameters in which stations differ
};

/// A level with a smaller reliability is not known.
inline constexpr double kReliable = 0.5;

/// Whose fault the spread of each parameter is: see docs/attribution.md.
LineAttribution attribute(const LineTable& table, const AttributionOptions& options);

}  // namespace clampd::attribution
