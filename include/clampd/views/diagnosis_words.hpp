#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/views/diagnosis_subject.hpp"

namespace clampd::words {

/// "50.2 ± 0.4", to two digits of the standard deviation; without ± where sd is NaN or 0, "-" for NaN.
std::string with_sd(double value, double sd);

/// A parameter with its standard deviation, without unit; "not identifiable" where the runs do not tell.
std::string estimate(const EstimatedParameter& parameter);

/// The same in a unit that people read with ease: "3.02 ± 0.01 ms" for seconds; a choice by its name.
std::string quantity(const EstimatedParameter& parameter);

/// What an effect's parameter means; empty if the catalogue does not know them.
std::string meaning(const std::string& effect, const std::string& parameter);

/// "k1 -0.35, k2 35.2": as `quantity`, each with its name.
std::string quantities(std::span<const EstimatedParameter> parameters);

/// "1 in 2,300", "less than 1 in a million"; "33 %" where it is nothing special.
std::string chance(double p_value);

/// "cogging, backlash or force-lag"
std::string enumeration(std::span<const std::string> items, std::string_view last_word);

/// Where an equation is wrong, as part of a sentence: "the reading of clamp force". Here and below `torque`
/// is DiagnosisSubject::torque.
std::string place(Location location, std::string_view torque = "torque");

/// The whole meaning of it, as a sentence.
std::string meaning(Location location, std::string_view torque = "torque");

/// What a misfit depends on, as part of a sentence: "the motor's position".
std::string variable(std::string_view name, std::string_view torque = "torque");

/// A dependence less likely by chance than this is one.
inline constexpr double kSignificant = 0.01;

/// The variables that the misfit depends on significantly, strongest first, each once.
std::vector<std::string> depends_on(const Misfit& misfit);

/// The effect's cause as the catalogue words it; empty if it does not list it.
std::string cause(const std::string& effect);
/// In the effect's own words where it has some, or else as above.
std::string cause(const NamedEffect& effect);

/// Whether the verdict stands by the effects that the diagnosis found: an unexplained result names no cause.
bool explains(const Diagnosis& diagnosis);

/// What an effect without rivals is called in this result: "Cause", or that it does not explain the runs.
std::string_view role(const Diagnosis& diagnosis);

/// Whether the verdict leaves open if it is the effect of this name or one that does nearly as well.
bool has_rivals(const Diagnosis& diagnosis, const std::string& effect);

/// What to do for an experiment that is no manoeuvre; empty if it is one.
std::string how_to_record(const NextExperiment& experiment);

/// What the verdict is, for a heading: "the cause is cogging".
std::string headline(const Diagnosis& diagnosis, std::string_view torque = "torque");

/// A figure of the gain in words and numbers, before and after.
struct GainRow {
  std::string what;
  std::string before, after;
  bool better;
};

/// Whether there are figures from what was left out of the fit: whole runs, of a drive also parts of one.
bool has_gain(const Diagnosis& diagnosis, const DiagnosisSubject& subject);

/// "2 runs that the model was not fitted to"
std::string heldout_runs(const HeldOutGain& gain);

/// The figures that these runs have; none without has_gain().
std::vector<GainRow> gain_rows(const Diagnosis& diagnosis, const DiagnosisSubject& subject);

/// A parameter of the model before and after the effects joined it.
struct ParameterRow {
  EstimatedParameter before;  ///< NaN where it has none
  EstimatedParameter after;
  double moved_sd;          ///< the change over the standard deviation before; NaN where there is none
  bool is_in_base = false;  ///< whether the model had it before
};

std::vector<ParameterRow> parameter_rows(const Diagnosis& diagnosis);

}  // namespace clampd::words
