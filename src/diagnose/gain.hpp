#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "src/diagnose/hypothesis.hpp"

namespace clampd::diagnosing {

/// Base and extended model, both fitted without the runs that then judge them. `heldout` empty: every third
/// of `runs`; with fewer than three there is nothing to spare.
std::optional<HeldOutGain> held_out_gain(std::span<const Run> runs, std::span<const Run> heldout,
                                         const Hypothesis& base, const Hypothesis& extended,
                                         std::vector<std::string>& notices);

std::vector<RunView> views_of(std::span<const Run> runs, const Hypothesis& base, const Hypothesis& extended);

}  // namespace clampd::diagnosing
