#include "src/diagnose/selection.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "clampd/base/parallel.hpp"
#include "src/diagnose/evidence.hpp"
#include "src/diagnose/look.hpp"

namespace clampd::diagnosing {

namespace {

/// Of the candidates worth a fit: no more than these, and none that promises less than this share of the
/// best.
constexpr std::size_t kMaxFirstFits = 8;
constexpr std::size_t kMaxLaterFits = 5;
constexpr double kPromising = 0.2;
/// A fit may bring more than one step promises, but hardly from nothing.
constexpr double kBelowAlarm = 3.5;
/// Nor is a further one worth a fit that promises less than this share of what would matter.
constexpr double kLeastPromised = 0.25;
/// An effect that is there is known to be there, by this share of an alarm's evidence.
constexpr double kKnown = 0.5;
/// Two fits of one model that differ by no more have found the same place.
constexpr double kSame_nats = 5.0;
/// Beside another candidate.
constexpr double kAsGood_nats = 1.0;
/// Relative error of a harmonic's order.
constexpr double kHarmonic = 0.03;
/// Of what the best one gained: enough to be worth a fit from elsewhere.
constexpr double kFair = 0.5;
/// Of what the best one gained, in the form that each is tried in first: from here on another form may lead.
constexpr double kWorthRefining = 0.3;
/// Fitted to the end are those not behind the best rough fit by this share and these nats.
constexpr double kLeading = 0.8;
constexpr double kFarBehind_nats = 40.0;
/// Of those, only the ones whose rough fit has this share of an alarm's evidence.
constexpr double kNearAlarm = 0.5;
/// A further effect must bring this share of what the others bring: an effect of another form than the
/// candidate's leaves that much behind. Spikes neither have another form nor come from one: they stand alone.
constexpr double kMaterial = 0.01;
/// Two things wrong at once are so much rarer than one.
constexpr double kFurtherEffect = 0.1;
/// Of fewer, the one that would do for two was found first.
constexpr std::size_t kFewestToSimplify = 3;

/// Not behind the best gain by this share and by nats that decide.
bool is_within_reach(double gain, double best, double share) {
  return gain > std::min(share * best, best - kFarBehind_nats);
}

double rank(const Candidate& candidate) {
  return candidate.is_fitted && candidate.fitted.possible() ? candidate.significance_nats : -1e9;
}

void best_first(std::vector<Candidate>& candidates) {
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return rank(a) > rank(b); });
}

bool has(const Hypothesis& hypothesis, const Effect& effect) {
  const auto& present = hypothesis.estimate.parameters.effects;
  return std::any_of(present.begin(), present.end(),
                     [&](const EffectValues& values) { return values.effect == &effect; });
}

bool can_be_added(const Hypothesis& hypothesis, const Effect& effect) {
  const EffectValues values{&effect, std::vector<double>(info_of(effect).parameters.size())};
  return room_for(hypothesis.estimate.parameters, {&values, 1});
}

/// Whether these values of an effect are a harmonic of one of the same name that is there.
bool is_harmonic(const EffectValues& values, const Hypothesis& hypothesis) {
  const double order = values.values.back();
  for (const EffectValues& present : hypothesis.estimate.parameters.effects) {
    if (present.effect != values.effect) continue;
    const double ratio = std::max(order, present.values.back()) / std::min(order, present.values.back());
    if (ratio > 1.5 && std::abs(ratio - std::round(ratio)) < kHarmonic * ratio) return true;
  }
  return false;
}

/// Whether some form of it moves readings by whole rows: what one of them brings says nothing of the others.
bool is_delay(const Candidate& candidate) {
  if (candidate.starts.empty()) return false;
  const EffectValues& values = candidate.starts.front().values;
  const auto& parameters = info_of(*candidate.effect).parameters;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    if (parameters[i].role != EffectParameter::Role::Refinement) continue;
    for (const double choice : parameters[i].starts)
      if (!delays_of({candidate.effect, chosen_otherwise(*candidate.effect, values.values, i, choice)})
               .none())
        return true;
  }
  return false;
}

/// Leaves a further effect of the same name only the starts that it may be named for.
void keep_harmonics(const Hypothesis& hypothesis, Candidate& candidate) {
  std::erase_if(candidate.starts, [&](const Start& start) { return !is_harmonic(start.values, hypothesis); });
  predict(candidate);
}

/// An effect that was in a model, and the others as they were beside it: without it they bend around it.
struct TakenOut {
  EffectValues values;
  Hypothesis others;
};

/// What to judge the candidates by.
struct FitTask {
  const Hypothesis& hypothesis;  ///< beside which
  std::string words;             ///< for who waits
  double until = 0.0;            ///< share of the whole work that is done then
  double material = 0.0;         ///< one that gains less does not matter
  /// An effect that a fuller model, fitted to the end, has and the hypothesis lacks.
  const TakenOut* taken_out = nullptr;
  /// The hypothesis and a further effect, if it was fitted on the way.
  const Hypothesis* begun = nullptr;
};

class Selector {
 public:
  Selector(std::span<const Run> runs, const SelectionOptions& options)
      : runs_(runs), options_(options), alarm_(alarm_level(options.false_alarm)) {}

  /// All candidates beside a hypothesis, the promising ones fitted, best first.
  std::vector<Candidate> judge(const FitTask& task, double& share) {
    Contest contest{task, screened(task), {}};
    report(share + 0.4 * (task.until - share), task.words);
    contest.worth = worth_a_fit(contest.candidates, task);
    contest.is_stuck = !contest.worth.empty() && is_stuck(task.hypothesis);
    fit_first(contest);
    refine_leaders(contest);
    const bool is_settled = fit_itself(contest);
    finish_leaders(contest, is_settled);
    for (Candidate& candidate : contest.candidates)
      if (candidate.is_fitted && candidate.fitted.possible() && has(task.hypothesis, *candidate.effect) &&
          !is_harmonic(candidate.fitted.estimate.parameters.effects.back(), task.hypothesis))
        candidate.fitted.estimate.possible = false;
    share = task.until;
    report(share, task.words);
    best_first(contest.candidates);
    return std::move(contest.candidates);
  }

  /// Alarm threshold where so many other effects are in the model already.
  double alarm(std::size_t others) const { return others == 0 ? alarm_ : alarm_ - std::log(kFurtherEffect); }
  bool is_alarm(const Candidate& candidate, std::size_t others) const {
    return candidate.is_fitted && candidate.fitted.possible() && candidate.significance_nats > alarm(others);
  }

 private:
  void report(double share, const std::string& words) const {
    if (options_.progress) options_.progress(share, words);
  }
  bool given_up() const { return options_.given_up && options_.given_up(); }

  /// The candidates of one task, from screening to the end.
  struct Contest {
    const FitTask& task;
    std::vector<Candidate> candidates;
    std::vector<std::size_t> worth;  ///< of them, those that get a fit
    bool is_stuck = false;           ///< the hypothesis itself may be a fit that got stuck

    /// Whether it is the effect that a fuller model had.
    bool is_itself(const Candidate& candidate) const {
      return task.taken_out != nullptr && candidate.effect == task.taken_out->values.effect;
    }
    double largest_gain() const {
      double largest = 0.0;
      for (const Candidate& candidate : candidates)
        if (candidate.is_fitted) largest = std::max(largest, candidate.gain);
      return largest;
    }
  };

  /// Every effect that can be added, with what one step promises, the most promising first.
  std::vector<Candidate> screened(const FitTask& task) const {
    const Hypothesis& hypothesis = task.hypothesis;
    std::vector<const Effect*> tried;
    for (const Effect* effect : effects())
      if ((!has(hypothesis, *effect) || info_of(*effect).repeatable) && can_be_added(hypothesis, *effect))
        tried.push_back(effect);
    std::vector<Candidate> candidates = look_at(tried, hypothesis, runs_);
    for (Candidate& candidate : candidates)
      if (has(hypothesis, *candidate.effect)) keep_harmonics(hypothesis, candidate);
    std::sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
      return a.predicted_significance_nats > b.predicted_significance_nats;
    });
    return candidates;
  }

  std::vector<std::size_t> worth_a_fit(const std::vector<Candidate>& candidates, const FitTask& task) const {
    const std::size_t most_fits =
        task.hypothesis.estimate.parameters.effects.empty() ? kMaxFirstFits : kMaxLaterFits;
    const double best = candidates.empty() ? 0.0 : candidates.front().predicted_significance_nats;
    std::vector<std::size_t> worth;
    for (std::size_t i = 0; i < candidates.size() && worth.size() < most_fits; ++i)
      if (!candidates[i].is_fitted &&
          candidates[i].predicted_significance_nats > std::max(alarm_ - kBelowAlarm, kPromising * best) &&
          candidates[i].predicted_gain >= kLeastPromised * task.material)
        worth.push_back(i);
    return worth;
  }

  void fit_first(Contest& contest) const {
    const FitTask& task = contest.task;
    for (const std::size_t i : contest.worth)
      if (task.begun != nullptr &&
          contest.candidates[i].effect == task.begun->estimate.parameters.effects.back().effect)
        contest.candidates[i].fitted = *task.begun;
    for_each_index(contest.worth.size(), task.hypothesis.threads, [&](std::size_t i) {
      Candidate& candidate = contest.candidates[contest.worth[i]];
      if (given_up()) return;
      if (contest.is_itself(candidate))
        fit_from(task.taken_out->values, task.taken_out->others, task.hypothesis, candidate);
      else
        fit(candidate, task.hypothesis, contest.is_stuck);
    });
  }

  /// Tries the other forms of those that are not far behind; and, where an effect was taken out of a fuller
  /// model, fits them once more from the others as they were beside it.
  void refine_leaders(Contest& contest) const {
    const FitTask& task = contest.task;
    const double first = contest.largest_gain();
    for_each_index(contest.worth.size(), task.hypothesis.threads, [&](std::size_t i) {
      Candidate& candidate = contest.candidates[contest.worth[i]];
      if (!given_up() && !contest.is_itself(candidate) &&
          (is_delay(candidate) || is_within_reach(candidate.gain, first, kWorthRefining)))
        refine(candidate, task.hypothesis, contest.is_stuck);
    });
    if (task.taken_out == nullptr) return;
    const double fair = kFair * contest.largest_gain();
    for_each_index(contest.worth.size(), task.hypothesis.threads, [&](std::size_t i) {
      Candidate& candidate = contest.candidates[contest.worth[i]];
      if (!given_up() && !contest.is_itself(candidate) && candidate.fitted.possible() &&
          candidate.gain > fair)
        fit_from(candidate.fitted.estimate.parameters.effects.back(), task.taken_out->others, task.hypothesis,
                 candidate);
    });
  }

  /// The effect that was taken out was fitted to the end before; where others do as well it may have a better
  /// form. True if none of them does, so that nothing is left to be done for it.
  bool fit_itself(Contest& contest) const {
    bool is_settled = false;
    for (Candidate& candidate : contest.candidates) {
      if (!contest.is_itself(candidate) || !candidate.is_fitted) continue;
      is_settled =
          std::none_of(contest.candidates.begin(), contest.candidates.end(), [&](const Candidate& other) {
            return !contest.is_itself(other) && other.is_fitted && other.gain > candidate.gain - kClearly;
          });
      if (is_settled) continue;
      fit(candidate, contest.task.hypothesis, contest.is_stuck);
      refine(candidate, contest.task.hypothesis, contest.is_stuck);
    }
    return is_settled;
  }

  void finish_leaders(Contest& contest, bool is_settled) const {
    const Hypothesis& hypothesis = contest.task.hypothesis;
    const std::size_t others = hypothesis.estimate.parameters.effects.size();
    const double largest = contest.largest_gain();
    std::vector<std::size_t> leading;
    for (std::size_t i = 0; i < contest.candidates.size(); ++i) {
      const Candidate& candidate = contest.candidates[i];
      if (candidate.is_fitted && !(is_settled && contest.is_itself(candidate)) &&
          candidate.significance_nats > kNearAlarm * alarm(others) &&
          is_within_reach(candidate.gain, largest, kLeading))
        leading.push_back(i);
    }
    for_each_index(leading.size(), hypothesis.threads, [&](std::size_t i) {
      if (!given_up()) finish(contest.candidates[leading[i]], hypothesis);
    });
    follow_the_best(leading, hypothesis, contest.candidates);
  }

  /// A candidate that can do all that another can must not end below it, and one that is nearly the same
  /// should not end far below it: whoever ended lower is fitted once more from the brake and the noise of the
  /// one that ended highest.
  void follow_the_best(const std::vector<std::size_t>& leading, const Hypothesis& hypothesis,
                       std::vector<Candidate>& candidates) const {
    if (leading.size() < 2 || given_up()) return;
    const std::size_t best = *std::max_element(
        leading.begin(), leading.end(),
        [&](std::size_t a, std::size_t b) { return candidates[a].gain < candidates[b].gain; });
    const Candidate& highest = candidates[best];
    if (!highest.fitted.possible()) return;
    // Its runs are those that its own delays have moved: a candidate without delays begins from runs as the
    // hypothesis has them.
    Hypothesis there = hypothesis;
    there.estimate =
        without_effect(highest.fitted.estimate, highest.fitted.estimate.parameters.effects.size() - 1);
    for_each_index(leading.size(), hypothesis.threads, [&](std::size_t i) {
      Candidate& candidate = candidates[leading[i]];
      if (leading[i] == best || !candidate.fitted.possible() || given_up()) return;
      if (!is_within_reach(candidate.gain, highest.gain, kLeading)) return;
      const double reached = candidate.fitted.log_likelihood();
      if (reached >= highest.fitted.log_likelihood()) return;
      fit_from(candidate.fitted.estimate.parameters.effects.back(), there, hypothesis, candidate);
      if (candidate.fitted.log_likelihood() > reached) finish(candidate, hypothesis);
    });
  }

  std::span<const Run> runs_;
  const SelectionOptions& options_;
  double alarm_;
};

/// Those of a judged list that do as well as one with this evidence and log-likelihood. How many alternatives
/// were tried for a candidate speaks against chance, not for another candidate; nor does it speak for another
/// one that a candidate as good is no alarm by itself, where an effect is faint.
std::vector<Candidate> rivals_among(const std::vector<Candidate>& candidates, std::string_view name,
                                    double significance_nats, const Hypothesis& best, double alarm) {
  std::vector<Candidate> rivals;
  for (const Candidate& candidate : candidates) {
    if (candidate.name() == name || !candidate.is_fitted || !candidate.fitted.possible()) continue;
    const bool as_likely = candidate.fitted.degrees <= best.degrees &&
                           candidate.fitted.log_likelihood() > best.log_likelihood() - kClearly;
    const bool as_evident = candidate.significance_nats > significance_nats - kClearly;
    const bool as_good = candidate.fitted.log_likelihood() > best.log_likelihood() - kAsGood_nats;
    if (candidate.significance_nats > alarm ? as_likely || as_evident : as_evident && as_good)
      rivals.push_back(candidate);
  }
  return rivals;
}

/// Tried for its choices, when it was judged.
double alternatives_of(std::string_view name, const Selection& selection) {
  for (const std::vector<Candidate>& stage : selection.stages)
    for (const Candidate& candidate : stage)
      if (candidate.name() == name) return candidate.alternatives;
  return 1.0;
}

/// With a rival in an effect's place another one may be superfluous: takes the first model of one effect less
/// that does as well. Whether there was one.
bool simplify(std::span<const Run> runs, double alarm, Selection& selection) {
  if (selection.effects.size() < kFewestToSimplify) return false;
  for (const Selected& selected : selection.effects)
    for (const Candidate& rival : selected.rivals)
      for (std::size_t other = 0; other + 1 < selection.effects.size(); ++other) {
        Hypothesis simpler = without(rival.fitted, other, runs);
        if (!simpler.possible()) continue;
        const double degrees = std::max(1.0, selection.chosen.degrees - simpler.degrees);
        if (significance_of(selection.chosen.log_likelihood() - simpler.log_likelihood(), degrees, 1.0) >=
            alarm)
          continue;
        std::vector<Selected> left;
        for (const EffectValues& values : simpler.estimate.parameters.effects) {
          const std::string_view name = info_of(*values.effect).name;
          const auto before = std::find_if(selection.effects.begin(), selection.effects.end(),
                                           [&](const Selected& present) { return present.name == name; });
          const bool is_rival = before == selection.effects.end();
          left.push_back({std::string(name),
                          is_rival ? rival.gain : before->gain,
                          is_rival ? rival.significance_nats : before->significance_nats,
                          {}});
        }
        selection.chosen = std::move(simpler);
        selection.effects = std::move(left);
        return true;
      }
  return false;
}

/// A model less one of its effects, fitted again.
struct Reduced {
  Hypothesis hypothesis;
  bool as_before = false;  ///< it is where the search was before it added the effect
};

/// `is_unchanged`: nothing was exchanged or removed since the last effect was added. Without that one the
/// model is where the search was before, and what else was there to add is known; unless that was no more
/// than a poor fit of the others.
Reduced reduced_by(std::size_t effect, bool is_unchanged, std::span<const Run> runs,
                   const Selection& selection) {
  Reduced reduced{without(selection.chosen, effect, runs),
                  is_unchanged && effect + 1 == selection.effects.size()};
  if (!reduced.as_before) return reduced;
  const Hypothesis& before = selection.stages[effect - 1].front().fitted;
  reduced.as_before = !reduced.hypothesis.possible() ||
                      reduced.hypothesis.log_likelihood() < before.log_likelihood() + kSame_nats;
  if (!reduced.hypothesis.possible() || before.log_likelihood() > reduced.hypothesis.log_likelihood())
    reduced.hypothesis = before;
  return reduced;
}

/// Every candidate in the place of one effect of the chosen model, best first.
std::vector<Candidate> in_place_of(std::size_t effect, const Hypothesis& reduced, bool as_before,
                                   Selector& selector, Selection& selection) {
  const double until = selection.share + 0.4 * (0.97 - selection.share);
  if (as_before) {
    std::vector<Candidate> candidates = selection.stages[effect];
    for (Candidate& candidate : candidates)
      if (candidate.is_fitted && candidate.fitted.possible()) weigh(candidate, reduced);
    best_first(candidates);
    selection.share = until;
    return candidates;
  }
  TakenOut taken_out{selection.chosen.estimate.parameters.effects[effect], reduced};
  taken_out.others.estimate = without_effect(selection.chosen.estimate, effect);
  return selector.judge({.hypothesis = reduced,
                         .words = fmt::format("is {} needed?", selection.effects[effect].name),
                         .until = until,
                         .taken_out = &taken_out},
                        selection.share);
}

}  // namespace

double alarm_level(double false_alarm) {
  return std::log(static_cast<double>(effects().size()) / false_alarm);
}

bool add_effect(std::span<const Run> runs, const SelectionOptions& options, Selection& selection) {
  const std::size_t others = selection.effects.size();
  if (others == static_cast<std::size_t>(options.most_effects)) return false;
  Selector selector(runs, options);
  double formed = 0.0;
  for (const Selected& selected : selection.effects)
    if (!info_of(*find_effect(selected.name)).removes_readings) formed += selected.gain;
  FitTask task{.hypothesis = selection.chosen,
               .words = "trying every effect",
               .until = selection.share + 0.5 * (0.95 - selection.share),
               .material = kMaterial * formed};
  if (others > 0) {
    task.words = fmt::format("trying every effect beside {} found", others);
    const Candidate& added = selection.stages.back().front();
    if (added.twice.possible() &&
        is_harmonic(added.twice.estimate.parameters.effects.back(), selection.chosen))
      task.begun = &added.twice;
  }
  selection.stages.push_back(selector.judge(task, selection.share));
  const std::vector<Candidate>& candidates = selection.stages.back();
  if (candidates.empty() || !selector.is_alarm(candidates.front(), others)) return false;
  const Candidate& best = candidates.front();
  if (!info_of(*best.effect).removes_readings && best.gain < kMaterial * formed) return false;
  selection.effects.push_back(
      {std::string(best.name()), best.gain, best.significance_nats,
       rivals_among(candidates, best.name(), best.significance_nats, best.fitted, selector.alarm(others))});
  selection.chosen = best.fitted;
  return true;
}

bool reconsider(std::span<const Run> runs, const SelectionOptions& options, Selection& selection) {
  if (selection.effects.size() < 2) return false;
  Selector selector(runs, options);
  const std::size_t added = selection.effects.size();
  int exchanges = 0;
  bool changed = false;
  for (std::size_t e = 0; selection.effects.size() > 1;) {
    if (e == selection.effects.size()) {
      if (!simplify(runs, selector.alarm(selection.effects.size() - 1), selection)) break;
      ++exchanges;
      changed = true;
      e = 0;
    }
    const auto [reduced, as_before] =
        reduced_by(e, exchanges == 0 && selection.effects.size() == added, runs, selection);
    // A fit that got lost says nothing against the effect.
    if (!reduced.possible() || reduced.log_likelihood() < selection.base.log_likelihood()) {
      ++e;
      continue;
    }
    const std::string name = selection.effects[e].name;
    const double gain = selection.chosen.log_likelihood() - reduced.log_likelihood();
    const double alarm = selector.alarm(selection.effects.size() - 1);
    double significance_nats =
        significance_of(gain, selection.chosen.degrees - reduced.degrees, alternatives_of(name, selection));
    if (significance_nats < alarm || known_strength(selection.chosen, e) < kKnown * alarm) {
      changed = true;
      selection.chosen = reduced;
      selection.effects.erase(selection.effects.begin() + static_cast<std::ptrdiff_t>(e));
      e = 0;
      continue;
    }
    const std::vector<Candidate> candidates = in_place_of(e, reduced, as_before, selector, selection);
    const auto itself = std::find_if(candidates.begin(), candidates.end(),
                                     [&](const Candidate& candidate) { return candidate.name() == name; });
    // A fit of the same name may have ended higher than where the search came from.
    if (itself != candidates.end() && itself->is_fitted && itself->significance_nats > significance_nats &&
        itself->fitted.possible())
      significance_nats = itself->significance_nats;
    Selected& selected = selection.effects[e];
    selected.gain = gain;
    selected.significance_nats = significance_nats;
    selected.rivals = rivals_among(candidates, name, significance_nats, selection.chosen, alarm);
    const bool exchange =
        !selected.rivals.empty() && selected.rivals.front().significance_nats > significance_nats;
    if (exchange && exchanges++ < options.most_effects) {
      // The new one takes its place at the end; what it replaces becomes its rival.
      Candidate better = selected.rivals.front();
      changed = true;
      selection.chosen = better.fitted;
      selection.effects.erase(selection.effects.begin() + static_cast<std::ptrdiff_t>(e));
      selection.effects.push_back(
          {std::string(better.name()), better.gain, better.significance_nats,
           rivals_among(candidates, better.name(), better.significance_nats, better.fitted, alarm)});
      continue;
    }
    ++e;
  }
  return changed;
}

}  // namespace clampd::diagnosing
