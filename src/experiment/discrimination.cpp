#include "clampd/experiment/discrimination.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <nlopt.h>

#include "clampd/base/clock.hpp"
#include "clampd/base/parallel.hpp"
#include "clampd/experiment/reference.hpp"
#include "discrimination_value.hpp"
#include "drive_off.hpp"

namespace clampd {

namespace {

using Segments = std::vector<ManoeuvreSegment>;

/// Of the limits of force and speed, what the nominal brake may use: rivals track it with errors.
constexpr double kNominalShare = 0.9;
constexpr double kLeastForce_N = 300.0;
constexpr double kMaxOpening_rad = 12.0;
constexpr double kLeastSwing_rad = 1e-3;
constexpr double kShortestSegment_s = 0.01;
/// Of the rivals while the search goes on.
constexpr int kSearchRelinearisations = 1;
/// Nats per sample that an evidence without meaning counts: hardly more than nothing.
constexpr double kIncredible = 1e-8;
/// Prototypes whose rivals may answer as well as they can before some are chosen.
constexpr std::size_t kLookedAtAgain = 24;
/// A prototype that is too fast is tried again, slower.
constexpr double kSlower = 1.3;
constexpr int kSlowerTries = 5;

struct Prototype {
  std::string_view kind;
  Segments segments;
};

Segments repeated(const Segments& pattern, int times, const Segments& first) {
  Segments all = first;
  for (int i = 0; i < times; ++i) all.insert(all.end(), pattern.begin(), pattern.end());
  return all;
}

constexpr ManoeuvreSegment to(double duration_s, double force_N) {
  return {.duration_s = duration_s, .force_N = force_N};
}
constexpr ManoeuvreSegment open_to(double duration_s, double opening_rad) {
  return {.duration_s = duration_s, .opening_rad = opening_rad};
}

/// To and fro with all torque. What tells a lag from a delay of a fraction of a row is the acceleration, and
/// of the velocity the moment when friction turns round.
Segments shaken(const ManoeuvreSegment& there, double swing_rad, double torque_Nm) {
  return {there, {.duration_s = 0.9, .swing_rad = swing_rad, .torque_Nm = torque_Nm}};
}

/// Manoeuvres of every kind that shows an effect: what the search starts from.
std::vector<Prototype> prototypes() {
  std::vector<Prototype> all;
  for (const auto& [low_N, high_N] :
       {std::pair{1e3, 6e3}, {3e3, 12e3}, {8e3, 20e3}, {15e3, 20e3}, {1e3, 20e3}}) {
    for (const double t_s : {0.03, 0.06, 0.12})
      all.push_back(
          {"reversals under load", repeated({to(t_s, low_N), to(t_s, high_N)}, 3, {to(0.15, high_N)})});
    for (const double t_s : {0.04, 0.1})
      all.push_back({"reversals under load with holds",
                     repeated({to(t_s, low_N), to(t_s, low_N), to(t_s, high_N), to(t_s, high_N)}, 2,
                              {to(0.15, high_N)})});
    for (const int cycles : {2, 5, 12, 20})
      all.push_back({"a sinusoid in force",
                     {to(0.12, low_N), {.duration_s = 0.5, .force_N = high_N, .cycles = cycles}}});
  }
  for (const double force_N : {3e3, 8e3, 14e3, 21e3}) {
    for (const double t_s : {0.07, 0.15, 0.3}) {
      all.push_back(
          {"apply and release", {to(t_s, force_N), open_to(t_s, 0.0), to(t_s, force_N), open_to(t_s, 0.0)}});
      all.push_back({"apply, hold and release",
                     {to(t_s, force_N), to(0.2, force_N), open_to(t_s, 0.0), open_to(0.1, 0.0)}});
    }
    all.push_back({"a fast step and a hold", {to(0.08, force_N), to(0.5, force_N)}});
    all.push_back(
        {"a fast step and a partial release",
         {to(0.1, force_N), to(0.08, force_N), to(0.06, 0.65 * force_N), to(0.06, 0.65 * force_N)}});
    all.push_back({"a slow ramp", {to(0.7, force_N), to(0.1, force_N), open_to(0.2, 0.0)}});
    all.push_back({"apply out of the clearance",
                   {open_to(0.15, 6.0), to(0.15, force_N), open_to(0.15, 6.0), to(0.15, force_N)}});
    all.push_back({"steps up and down",
                   {to(0.1, force_N / 3), to(0.05, force_N / 3), to(0.06, force_N * 2 / 3),
                    to(0.05, force_N * 2 / 3), to(0.06, force_N), to(0.05, force_N), to(0.06, force_N / 2),
                    to(0.05, force_N / 2), open_to(0.15, 0.0)}});
  }
  for (const double opening_rad : {1.5, 4.0, 10.0})
    for (const double t_s : {0.05, 0.1, 0.2, 0.4})
      all.push_back({"sweeps in the clearance",
                     repeated({open_to(t_s, opening_rad), open_to(t_s, 0.3)}, t_s < 0.2 ? 3 : 2, {})});
  for (const double torque_Nm : {1.6, 2.6})
    for (const double swing_rad : {0.015, 0.03, 0.15, 0.6}) {
      all.push_back({"shaking in the clearance", shaken(open_to(0.1, 3.0), swing_rad, torque_Nm)});
      for (const auto& [t_s, force_N] : {std::pair{0.12, 4e3}, {0.18, 9e3}, {0.27, 20e3}})
        all.push_back({"shaking under load", shaken(to(t_s, force_N), swing_rad, torque_Nm)});
    }
  all.push_back({"fast and slow sweeps in the clearance",
                 {open_to(0.1, 8.0), open_to(0.1, 0.5), open_to(0.5, 8.0), open_to(0.5, 0.5)}});
  return all;
}

bool is_hold(const Segments& segments, std::size_t i) {
  return i > 0 && segments[i].cycles == 0 && segments[i].swing_rad == 0.0 &&
         segments[i].force_N == segments[i - 1].force_N &&
         segments[i].opening_rad == segments[i - 1].opening_rad;
}

double duration_of(const Segments& segments) {
  double sum = 0.0;
  for (const ManoeuvreSegment& segment : segments) sum += segment.duration_s;
  return sum;
}

void stretch(Segments& segments, double by) {
  for (ManoeuvreSegment& segment : segments) segment.duration_s *= by;
}

/// Half as fast takes twice as long, or half the torque where that makes the pace.
void slow_down(Segments& segments, double by) {
  stretch(segments, by);
  for (ManoeuvreSegment& segment : segments) segment.torque_Nm /= by;
}

void fit_duration(Segments& segments, const DiscriminationOptions& options) {
  const double duration_s = duration_of(segments);
  stretch(segments, std::clamp(duration_s, options.shortest_s, options.longest_s) / duration_s);
  for (ManoeuvreSegment& segment : segments)
    segment.duration_s = std::max(kShortestSegment_s, std::round(segment.duration_s / kPeriod_s) * kPeriod_s);
}

/// Durations as logarithms, forces and openings as shares; holds follow the level before them.
class Knobs {
 public:
  Knobs(const Segments& prototype, const DiscriminationOptions& options) : prototype_(prototype) {
    const double most_N = kNominalShare * options.force_limit_N;
    for (std::size_t i = 0; i < prototype.size(); ++i) {
      add(i, Knob::Duration, std::log(prototype[i].duration_s), std::log(kShortestSegment_s),
          std::log(options.longest_s), 0.3);
      if (is_hold(prototype, i)) continue;
      if (prototype[i].swing_rad > 0.0) {
        add(i, Knob::Swing, std::log(prototype[i].swing_rad), std::log(kLeastSwing_rad),
            std::log(kMaxOpening_rad), 0.3);
        add(i, Knob::Torque, std::log(prototype[i].torque_Nm), std::log(0.1 * options.torque_limit_Nm),
            std::log(kNominalShare * options.torque_limit_Nm), 0.1);
      } else if (prototype[i].force_N > 0.0)
        add(i, Knob::Force, prototype[i].force_N / most_N, kLeastForce_N / most_N, 1.0, 0.15);
      else if (prototype[i].opening_rad > 0.0)
        add(i, Knob::Opening, prototype[i].opening_rad / kMaxOpening_rad, 0.02, 1.0, 0.15);
    }
    force_scale_N_ = most_N;
  }

  std::vector<double> start, lower, upper, step;

  Segments at(const double* x, const DiscriminationOptions& options) const {
    Segments segments = prototype_;
    for (std::size_t i = 0; i < knobs_.size(); ++i) {
      ManoeuvreSegment& segment = segments[knobs_[i].segment];
      switch (knobs_[i].kind) {
        case Knob::Duration:
          segment.duration_s = std::exp(x[i]);
          break;
        case Knob::Force:
          segment.force_N = force_scale_N_ * x[i];
          break;
        case Knob::Opening:
          segment.opening_rad = kMaxOpening_rad * x[i];
          break;
        case Knob::Swing:
          segment.swing_rad = std::exp(x[i]);
          break;
        case Knob::Torque:
          segment.torque_Nm = std::exp(x[i]);
          break;
      }
    }
    for (std::size_t i = 1; i < segments.size(); ++i)
      if (is_hold(prototype_, i)) {
        segments[i].force_N = segments[i - 1].force_N;
        segments[i].opening_rad = segments[i - 1].opening_rad;
      }
    fit_duration(segments, options);
    return segments;
  }

 private:
  struct Knob {
    std::size_t segment;
    enum Kind { Duration, Force, Opening, Swing, Torque } kind;
  };
  void add(std::size_t segment, Knob::Kind kind, double value, double low, double high, double size) {
    knobs_.push_back({segment, kind});
    start.push_back(std::clamp(value, low, high));
    lower.push_back(low);
    upper.push_back(high);
    step.push_back(size);
  }

  Segments prototype_;
  std::vector<Knob> knobs_;
  double force_scale_N_ = 0.0;
};

struct Candidate {
  std::string_view kind;
  Segments segments;
  double rate = -std::numeric_limits<double>::infinity();  ///< nats per sample
};

class Search {
 public:
  Search(const RivalComparison& comparison, const BrakeParameters& nominal,
         const DiscriminationOptions& options)
      : comparison_(comparison), nominal_(nominal), options_(options) {
    limits_.force_limit_N = kNominalShare * options.force_limit_N * (1.0 + 1e-6);
    limits_.velocity_limit_rad_s = kNominalShare * options.velocity_limit_rad_s;
    limits_.torque_limit_Nm = kNominalShare * options.torque_limit_Nm;
  }

  Result<Reference> reference_of(const Segments& segments) const {
    const Result<Run> run = follow_segments("discrimination", segments, nominal_);
    if (!run) return tl::unexpected(run.error());
    return build_reference(*run, nominal_, limits_);
  }

  double rate_of(const Segments& segments, int relinearisations = 0) const {
    const Result<Reference> reference = reference_of(segments);
    if (!reference) return -std::numeric_limits<double>::infinity();
    const DiscriminationValue value = comparison_.evaluate(*reference, relinearisations);
    if (!value.feasible) return -std::numeric_limits<double>::infinity();
    return value.credible ? value.evidence_per_sample_nats : kIncredible;
  }

  /// As fast as the rivals bear it.
  Candidate coarse(const Prototype& prototype) const {
    Candidate candidate{prototype.kind, prototype.segments};
    for (int i = 0; i < kSlowerTries; ++i) {
      fit_duration(candidate.segments, options_);
      candidate.rate = rate_of(candidate.segments);
      if (std::isfinite(candidate.rate) || duration_of(candidate.segments) >= options_.longest_s) break;
      slow_down(candidate.segments, kSlower);
    }
    return candidate;
  }

  Candidate refined(const Candidate& start, int evaluations) const {
    Refinement refinement{*this, Knobs(start.segments, options_), start};
    refinement.best.rate = -std::numeric_limits<double>::infinity();
    const Knobs& knobs = refinement.knobs;
    const auto size = static_cast<unsigned>(knobs.start.size());
    struct Deleter {
      void operator()(nlopt_opt optimiser) const { nlopt_destroy(optimiser); }
    };
    const std::unique_ptr<std::remove_pointer_t<nlopt_opt>, Deleter> optimiser(
        nlopt_create(NLOPT_LN_COBYLA, size));
    nlopt_set_min_objective(optimiser.get(), objective, &refinement);
    nlopt_set_lower_bounds(optimiser.get(), knobs.lower.data());
    nlopt_set_upper_bounds(optimiser.get(), knobs.upper.data());
    nlopt_set_initial_step(optimiser.get(), knobs.step.data());
    nlopt_set_maxeval(optimiser.get(), evaluations);
    nlopt_set_xtol_abs1(optimiser.get(), 2e-3);
    std::vector<double> x = knobs.start;
    double reached = 0.0;
    // However it ends, the best that it passed counts.
    nlopt_optimize(optimiser.get(), x.data(), &reached);
    return refinement.best;
  }

 private:
  struct Refinement {
    const Search& search;
    Knobs knobs;
    Candidate best;
  };
  static double objective(unsigned, const double* x, double*, void* data) {
    auto& refinement = *static_cast<Refinement*>(data);
    const Search& search = refinement.search;
    Segments segments = refinement.knobs.at(x, search.options_);
    const double rate = search.rate_of(segments, kSearchRelinearisations);
    if (rate > refinement.best.rate) {
      refinement.best.rate = rate;
      refinement.best.segments = std::move(segments);
    }
    // What cannot be done is worse than what tells nothing, and finite.
    constexpr double kNothing = 1e-9;
    return -std::log(std::max(rate, kNothing)) + (std::isfinite(rate) ? 0.0 : 5.0);
  }

  const RivalComparison& comparison_;
  const BrakeParameters& nominal_;
  const DiscriminationOptions& options_;
  ReferenceOptions limits_;
};

void by_rate(std::vector<Candidate>& candidates) {
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.rate > b.rate; });
}

std::string in_words(const Discrimination& design, std::span<const RivalModel> rivals, std::string_view kind,
                     double enough_nats) {
  const std::string names = names_of(rivals);
  const double duration_s = static_cast<double>(design.trajectory.size()) * kPeriod_s;
  if (!design.settles)
    return fmt::format(
        "{} cannot be told apart by any manoeuvre that was tried: {} runs of the best one, {} in "
        "{:.2f} s, would give {:.1f} nats between {} and {}, and it takes {:.0f}",
        names, design.repeats, kind, duration_s, design.expected_evidence_nats, rivals[design.first].name,
        rivals[design.second].name, enough_nats);
  return fmt::format(
      "{} would read differently in {}: {} run{} of {:.2f} s, up to {:.1f} kN, should give {:.0f} nats{}",
      names, kind, design.repeats, design.repeats == 1 ? "" : "s", duration_s,
      1e-3 * *std::max_element(design.trajectory.force_N.begin(), design.trajectory.force_N.end()),
      design.expected_evidence_nats,
      rivals.size() > 2 ? fmt::format(" between {} and {}, the two hardest to tell apart",
                                      rivals[design.first].name, rivals[design.second].name)
                        : "");
}

}  // namespace

Result<void> DiscriminationOptions::validate() const {
  const std::pair<std::string_view, double> positive[] = {{"torque_limit_Nm", torque_limit_Nm},
                                                          {"force_limit_N", force_limit_N},
                                                          {"velocity_limit_rad_s", velocity_limit_rad_s},
                                                          {"shortest_s", shortest_s},
                                                          {"wanted_nats", wanted_nats},
                                                          {"longest_off_s", longest_off_s},
                                                          {"enough_nats", enough_nats}};
  for (const auto& [name, value] : positive)
    if (!std::isfinite(value) || !(value > 0.0))
      return failure(fmt::format("discrimination: {} = {} must be positive and finite", name, value));
  if (!(longest_s >= shortest_s && longest_s <= 10.0))
    return failure(
        fmt::format("discrimination: longest_s = {} must be at least shortest_s = {} and at most 10",
                    longest_s, shortest_s));
  if (most_repeats < 1 || most_repeats > 200)
    return failure(fmt::format("discrimination: most_repeats = {} must be 1 to 200", most_repeats));
  if (prototypes_kept < 1 || refinement_evaluations < 1)
    return failure("discrimination: prototypes_kept and refinement_evaluations must be positive");
  return {};
}

Result<Discrimination> design_discrimination(std::span<const RivalModel> rivals, const NoiseLevels& noise,
                                             const BrakeParameters& nominal,
                                             const DiscriminationOptions& options) {
  if (rivals.size() < 2 || rivals.size() > 3)
    return failure(fmt::format("a discrimination is between two or three rivals, not {}", rivals.size()));
  Result<void> valid = options.validate();
  if (valid) valid = check_rivals(rivals);
  if (!valid) return tl::unexpected(valid.error());

  Discrimination off = design_drive_off(rivals, noise, options);
  if (off.expected_evidence_nats >= options.wanted_nats) return off;
  const int threads = threads_or_all(options.threads);
  const RivalComparison comparison(rivals, noise, nominal, options);
  const Search search(comparison, nominal, options);
  const std::vector<Prototype> all = prototypes();
  std::vector<Candidate> candidates(all.size());
  for_each_index(all.size(), threads, [&](std::size_t i) { candidates[i] = search.coarse(all[i]); });
  by_rate(candidates);
  std::erase_if(candidates, [](const Candidate& candidate) { return !std::isfinite(candidate.rate); });
  if (candidates.empty())
    return failure(
        "no manoeuvre within the limits that all rivals can do; are their parameters those of a brake?");

  for_each_index(std::min(candidates.size(), kLookedAtAgain), threads, [&](std::size_t i) {
    candidates[i].rate = search.rate_of(candidates[i].segments, kCarefulRelinearisations);
  });
  candidates.resize(std::min(candidates.size(), kLookedAtAgain));
  by_rate(candidates);

  // The best, and the best of other kinds.
  std::vector<Candidate> kept;
  for (int round = 0; round < 2; ++round)
    for (const Candidate& candidate : candidates) {
      if (kept.size() == static_cast<std::size_t>(options.prototypes_kept)) break;
      const auto of_kind = std::count_if(
          kept.begin(), kept.end(), [&](const Candidate& other) { return other.kind == candidate.kind; });
      if (of_kind == round) kept.push_back(candidate);
    }
  const auto pairs = static_cast<int>(rivals.size() * (rivals.size() - 1) / 2);
  const int evaluations = std::max(1, options.refinement_evaluations / pairs);
  for_each_index(kept.size(), threads,
                 [&](std::size_t i) { kept[i] = search.refined(kept[i], evaluations); });
  kept.push_back(candidates.front());
  // From here on with rivals that answer as well as they can.
  for_each_index(kept.size(), threads, [&](std::size_t i) {
    kept[i].rate = search.rate_of(kept[i].segments, kCarefulRelinearisations);
  });
  by_rate(kept);

  Discrimination design;
  const Candidate& best = kept.front();
  design.segments = best.segments;
  Result<Run> trajectory = follow_segments(fmt::format("settle: {}", best.kind), best.segments, nominal);
  if (!trajectory) return tl::unexpected(trajectory.error());
  design.trajectory = std::move(*trajectory);
  design.name = std::string(best.kind);
  const Result<Reference> reference = search.reference_of(best.segments);
  if (!reference) return tl::unexpected(reference.error());
  const DiscriminationValue value = comparison.evaluate(*reference, kCarefulRelinearisations);
  design.evidence_nats = value.evidence_nats;
  design.evidence_per_sample_nats = value.evidence_per_sample_nats;
  design.first = value.first;
  design.second = value.second;
  // The fewest that are enough: more runs never tell less.
  const auto evidence_nats = [&](int repeats) {
    return comparison.evidence_after(*reference, repeats, kCarefulRelinearisations);
  };
  int too_few = 0;
  design.repeats = options.most_repeats;
  design.expected_evidence_nats = evidence_nats(design.repeats);
  while (design.expected_evidence_nats >= options.wanted_nats && design.repeats - too_few > 1) {
    const int middle = (too_few + design.repeats) / 2;
    const double expected_nats = evidence_nats(middle);
    if (expected_nats >= options.wanted_nats) {
      design.repeats = middle;
      design.expected_evidence_nats = expected_nats;
    } else {
      too_few = middle;
    }
  }
  if (!value.credible) {
    // No kind of manoeuvre keeps the rivals from losing their way: far apart, but nobody knows how far.
    design.evidence_nats = std::min(design.evidence_nats, options.wanted_nats);
    design.expected_evidence_nats = std::min(design.expected_evidence_nats, options.wanted_nats);
  }
  design.settles = design.expected_evidence_nats >= options.enough_nats;
  design.why = in_words(design, rivals, best.kind, options.enough_nats);
  if (!design.settles && off.settles) return off;
  return design;
}

}  // namespace clampd
