#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "src/diagnose/hypothesis.hpp"

namespace clampd::diagnosing {

struct SelectionOptions {
  int most_effects = 4;
  double false_alarm = 0.005;
  std::function<void(double, const std::string&)> progress;
  std::function<bool()> given_up;  ///< what is judged after that counts for nothing
};

/// Names within so many nats of evidence of the best are its rivals.
inline constexpr double kClearly = 5.0;

struct Selected {
  std::string name;
  double gain = 0.0;               ///< nats that the model loses without it
  double significance_nats = 0.0;  ///< of that, its own alternatives counted
  /// Those that do as well in its place, best first, each fitted; itself not among them.
  std::vector<Candidate> rivals;
};

struct Selection {
  Hypothesis base;
  Hypothesis chosen;
  std::vector<Selected> effects;               ///< in the order of the chosen model's
  std::vector<std::vector<Candidate>> stages;  ///< every candidate of each round, best first
  double share = 0.15;                         ///< of the whole work that is done
};

/// Evidence from which on a candidate is more than chance among all that were tried.
double alarm_level(double false_alarm);

/// Adds the effect that is most clearly there; false if none is more than chance, or there are enough.
bool add_effect(std::span<const Run> runs, const SelectionOptions& options, Selection& selection);

/// Looks at each effect that was added again, with all others there: takes out or exchanges what has become
/// superfluous, and finds the rivals. Whether the chosen model is another then.
bool reconsider(std::span<const Run> runs, const SelectionOptions& options, Selection& selection);

}  // namespace clampd::diagnosing
