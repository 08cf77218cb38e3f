#pragma once

#include <optional>
#include <span>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "src/diagnose/hypothesis.hpp"

namespace clampd::diagnosing {

/// What the innovations of a hypothesis still hide.
struct Residuals {
  std::vector<MisfitTest> tests;
  std::vector<Dependence> dependences;  ///< strongest first
  /// -ln p of the most surprising of all tests and dependences, their number counted.
  double neg_log_p = 0.0;
  /// Where to look if no dependence tells: from the test that fails most.
  std::optional<Location> hint;
  /// What a model of the strongest finding would gain, nats.
  double nats = 0.0;
};

Residuals examine(const Hypothesis& hypothesis);

/// How surprising the innovations' correlation with the ones before them is, force and velocity together.
double neg_log_p_of_colour(std::span<const FilteredRun> runs);

}  // namespace clampd::diagnosing
