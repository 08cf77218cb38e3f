#pragma once

#include <span>
#include <vector>

#include "src/diagnose/hypothesis.hpp"

namespace clampd::diagnosing {

/// Everything about how promising effects are beside a hypothesis, without fitting them; spikes, which have
/// nothing to fit, are found. One candidate for each, in that order.
std::vector<Candidate> look_at(std::span<const Effect* const> tried, const Hypothesis& hypothesis,
                               std::span<const Run> recorded);

/// What a candidate promises, by the best of its starts.
void predict(Candidate& candidate);

/// Parameters that an effect adds to a model of so many runs, those of each run among them.
double degrees_of(const Effect& effect, std::size_t runs);

/// Starts at the peaks of what the scan of its effect promises, each about what it can bring. Runs over a short stretch of the motor angle
/// make peaks beside the true one, too close for the scan, that a fit does not leave: the best are looked at
/// closely. `filtered`: the hypothesis's runs.
void add_peaks(const Hypothesis& hypothesis, std::span<const FilteredRun> filtered, Candidate& candidate);

}  // namespace clampd::diagnosing
