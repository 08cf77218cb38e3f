#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/base/result.hpp"

namespace clampd::quality {

/// One measurement of a part by an operator.
struct GaugeReading {
  std::string part;
  std::string operator_name;
  double value = 0.0;
};

struct GaugeOptions {
  double tolerance =
      std::numeric_limits<double>::quiet_NaN();  ///< upper minus lower limit; NaN: there is none
  double pooling_p =
      0.25;  ///< an interaction less significant than this becomes part of repeatability (AIAG)
};

struct AnovaRow {
  std::string source;
  double freedom = 0.0;
  double sum_of_squares = 0.0;
  double mean_square = 0.0;
  double f = std::numeric_limits<double>::quiet_NaN();
  double p = std::numeric_limits<double>::quiet_NaN();
};

/// One source of variation.
struct GaugeComponent {
  double sd = 0.0;
  double of_total = 0.0;      ///< sd over that of the total variation, 0..1
  double of_tolerance = 0.0;  ///< 6 sd over the tolerance; NaN without one
};

/// A crossed gauge study (AIAG, Measurement Systems Analysis, 4th edition, III.B).
struct GaugeStudy {
  std::size_t parts = 0;
  std::size_t operators = 0;
  std::size_t repeats = 0;
  std::vector<AnovaRow> anova;  ///< parts, operators, interaction, repeatability, total; empty for ranges
  bool interaction_pooled = false;
  GaugeComponent repeatability;    ///< EV
  GaugeComponent operator_effect;  ///< AV without the interaction
  GaugeComponent interaction;
  GaugeComponent reproducibility;    ///< both of them
  GaugeComponent gauge;              ///< GRR
  GaugeComponent part_variation;     ///< PV
  GaugeComponent total;              ///< TV
  double distinct_categories = 0.0;  ///< 1.41 PV / GRR, to be rounded down
};

/// Analysis of variance of a crossed study, parts and operators random. Negative estimates of a variance are
/// zero. Errors, naming what is missing: fewer than two parts, operators or repeats, a part that an operator
/// measured less often than others, a value that is not finite.
Result<GaugeStudy> gauge_anova(std::span<const GaugeReading> readings, const GaugeOptions& options);

/// The average and range method on the same data; its interaction is part of the rest.
Result<GaugeStudy> gauge_average_range(std::span<const GaugeReading> readings, const GaugeOptions& options);

enum class GaugeGrade : std::uint8_t { Good, Conditional, Unacceptable };
std::string_view to_string(GaugeGrade grade) noexcept;  ///< "good", "conditional", "unacceptable"

/// By AIAG's guideline: a share below 10 % is good, up to 30 % depends on what is at stake.
GaugeGrade grade(double share) noexcept;

}  // namespace clampd::quality
