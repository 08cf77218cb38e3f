// Lines of simulated stations, of which attribute_effects() is asked what it finds: lines that hide nothing,
// and lines of which one station or batch has an effect that a single brake could not show. See
// docs/population.md.

#include <cmath>
#include <map>
#include <random>
#include <set>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "clampd/attribution/population.hpp"
#include "clampd/reanalysis/population.hpp"
#include "reanalysis/scored_line.hpp"

namespace clampd::support {
namespace {

using attribution::CheckGroup;
using attribution::PopulationFinding;

struct Plan {
  int stations = 4, batches = 8, brakes = 200;
  int repeats = 10;
  double spread = 0.0;  ///< of the stations' calibration: 1 is 0.2 % of force and torque, 1 mN m of offset,
                        ///< 20 us of the load cell's lag
  double size = 1.0;    ///< of what is hidden, in standard deviations of one check
  int lines = 2;        ///< of each effect, in turn at a station and in a batch
  int clean = 100;
  std::uint64_t seed = 1;
};

/// Effects whose size the simulated brake and the model mean the same by.
const std::vector<std::pair<std::string, std::string>> kHidden{
    {"force-lag", "time_constant"}, {"velocity-lag", "time_constant"}, {"torque-lag", "time_constant"},
    {"torque-gain", "gain_error"},  {"coulomb-load", "growth"},        {"quadratic-drag", "coefficient"},
    {"inertia-error", "relative"},  {"ratio-error", "relative"},       {"friction-asymmetry", "coulomb"},
    {"backlash", "play"},           {"stiffness-hysteresis", "share"}, {"pad-damping", "damping"},
    {"pad-relaxation", "share"},    {"torque-offset", "offset"}};

using Scores = EffectScores;

class Line {
 public:
  explicit Line(const Plan& plan) : plan_(plan), random_(plan.seed) {
    std::normal_distribution<double> normal(0.0, plan.spread);
    for (int s = 0; s < plan.stations; ++s) {
      calibration_.emplace_back();
      if (plan.spread == 0.0) continue;
      calibration_.back() = {{"ratio-error", 0.002 * normal(random_)},
                             {"torque-gain", 0.002 * normal(random_)},
                             {"torque-offset", 0.001 * normal(random_)},
                             {"force-lag", 2e-5 * std::abs(normal(random_))}};
    }
    for (int i = 0; i < plan.brakes; ++i) station_.push_back(i % plan.stations);
    clean_.resize(station_.size());
    for_each_index(clean_.size(), ThreadBudget(2),
                   [&](std::size_t i) { clean_[i] = check(plan.seed * 1'000'000 + i, i, {}); });
  }

  void show_scores() const;
  double of_one_check(const std::string& effect, const std::string& parameter) const;
  /// Draws the batches anew.
  std::vector<int> batches() {
    std::vector<int> batches;
    std::uniform_int_distribution<int> any(0, plan_.batches - 1);
    for (std::size_t i = 0; i < station_.size(); ++i) batches.push_back(any(random_));
    return batches;
  }
  reanalysis::Population population(const std::vector<const Scores*>& checks,
                                    const std::vector<int>& batches) const;
  reanalysis::Population clean(const std::vector<int>& batches) const {
    std::vector<const Scores*> checks;
    for (const Scores& scores : clean_) checks.push_back(&scores);
    return population(checks, batches);
  }
  /// The line with this effect at all brakes of one group.
  reanalysis::Population with(const HiddenInBrake& hidden, CheckGroup::Kind kind, int guilty,
                              const std::vector<int>& batches) {
    std::vector<Scores> own(station_.size());
    const std::uint64_t base = plan_.seed * 1'000'000 + 500'000 + random_() % 400'000;
    for_each_index(own.size(), ThreadBudget(2), [&](std::size_t i) {
      if ((kind == CheckGroup::Kind::Station ? station_ : batches)[i] == guilty)
        own[i] = check(base + i, i, {hidden});
    });
    std::vector<const Scores*> checks;
    for (std::size_t i = 0; i < own.size(); ++i)
      checks.push_back(own[i].directions.empty() ? &clean_[i] : &own[i]);
    return population(checks, batches);
  }
  std::mt19937_64& random() { return random_; }

 private:
  Scores check(std::uint64_t seed, std::size_t i, std::vector<HiddenInBrake> hidden) const {
    for (const HiddenInBrake& of_station : calibration_[static_cast<std::size_t>(station_[i])]) {
      auto same = std::find_if(hidden.begin(), hidden.end(),
                               [&](const auto& each) { return each.effect == of_station.effect; });
      if (same == hidden.end())
        hidden.push_back(of_station);
      else
        same->size += of_station.size;
    }
    return scored_check(seed, static_cast<std::uint32_t>(plan_.repeats), hidden);
  }

  const Plan plan_;
  std::mt19937_64 random_;
  std::vector<std::vector<HiddenInBrake>> calibration_;
  std::vector<int> station_;
  std::vector<Scores> clean_;
};

reanalysis::Population Line::population(const std::vector<const Scores*>& checks,
                                        const std::vector<int>& batches) const {
  std::vector<reanalysis::ScoredCheck> scored;
  for (std::size_t i = 0; i < checks.size(); ++i)
    scored.push_back({"", fmt::format("{}", i), fmt::format("{}", station_[i]), "",
                      fmt::format("{}", batches[i]), *checks[i]});
  return reanalysis::population_of(scored).value();
}

/// How the scores of clean checks are distributed, over the root of their information: mean 0, deviation 1 if
/// all is right.
void Line::show_scores() const {
  fmt::print("{:<55} {:>8} {:>8} {:>12}\n", "direction", "mean", "sd", "sd of one");
  const std::vector<EffectDirection>& directions = clean_.front().directions;
  for (std::size_t direction = 0; direction < directions.size(); ++direction) {
    const auto j = static_cast<Eigen::Index>(direction);
    double sum = 0.0, squares = 0.0, information = 0.0;
    const double n = static_cast<double>(clean_.size());
    for (const Scores& scores : clean_) {
      const double own = scores.information(j, j);
      const double z = own > 0.0 ? scores.score[j] / std::sqrt(own) : 0.0;
      sum += z, squares += z * z, information += own / n;
    }
    fmt::print("{:<55} {:>8.3f} {:>8.3f} {:>12.3g}\n",
               reanalysis::direction_in_words(directions[direction]).name, sum / n,
               std::sqrt(squares / n - sum * sum / n / n), 1.0 / std::sqrt(information));
  }
}

double Line::of_one_check(const std::string& effect, const std::string& parameter) const {
  const std::vector<EffectDirection>& directions = clean_.front().directions;
  for (std::size_t j = 0; j < directions.size(); ++j) {
    const EffectInfo& info = info_of(*directions[j].effect.effect);
    if (info.name != effect || info.parameters[directions[j].parameter].name != parameter) continue;
    double information = 0.0;
    for (const Scores& scores : clean_)
      information += scores.information(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(j)) /
                     static_cast<double>(clean_.size());
    return 1.0 / std::sqrt(information);
  }
  return 0.0;
}

const char* word(CheckGroup::Kind kind) {
  return kind == CheckGroup::Kind::Line ? "line" : kind == CheckGroup::Kind::Station ? "station" : "batch";
}

std::string in_words(const reanalysis::Population& population, const PopulationFinding::Suspect& suspect) {
  const CheckGroup& group = population.table.groups[static_cast<std::size_t>(suspect.group)];
  return fmt::format("{} {} {}", word(group.kind), group.name,
                     population.table.directions[static_cast<std::size_t>(suspect.direction)].name);
}

std::string in_words(const reanalysis::Population& population, const PopulationFinding& finding) {
  std::string text =
      fmt::format("{}, t {:.1f}, {:.3g}", in_words(population, finding.suspect), finding.t, finding.size);
  for (const auto& rival : finding.rivals) text += " | " + in_words(population, rival);
  return text;
}

std::string in_words(const reanalysis::Population& population,
                     const attribution::StationDifference& difference) {
  const auto name = [&](int direction) {
    return population.table.directions[static_cast<std::size_t>(direction)].name;
  };
  std::string text = fmt::format("stations differ in {}, {:.3g}, {:.1f} deviations of one check",
                                 name(difference.direction), difference.sd, difference.of_one_check);
  for (const int rival : difference.rivals) text += " | " + name(rival);
  return text;
}

/// With a spread the whole line's load cells lag.
bool may_be_false(const PopulationFinding& finding, double spread) {
  return spread == 0.0 || finding.suspect.group != 0;
}

struct Count {
  int lines = 0, named = 0, group = 0, wrong_group = 0, wrong_effect = 0;
};

/// Named: the effect is the one found or a rival of it, and so is its group.
void count(const reanalysis::Population& population, const attribution::PopulationResult& result,
           const std::string& effect, CheckGroup::Kind kind, int guilty, double spread, Count& count) {
  bool named = false, right_group = false, wrong_group = false, wrong_effect = false;
  for (const PopulationFinding& finding : result.findings) {
    if (!may_be_false(finding, spread)) continue;
    std::vector<PopulationFinding::Suspect> suspects{finding.suspect};
    suspects.insert(suspects.end(), finding.rivals.begin(), finding.rivals.end());
    bool group_here = false, effect_here = false;
    for (const auto& suspect : suspects) {
      const CheckGroup& group = population.table.groups[static_cast<std::size_t>(suspect.group)];
      const bool is_guilty = group.kind == kind && group.name == fmt::format("{}", guilty);
      group_here |= is_guilty;
      effect_here |=
          is_guilty &&
          info_of(*population.directions[static_cast<std::size_t>(suspect.direction)].effect.effect).name ==
              effect;
    }
    named |= effect_here;
    right_group |= group_here;
    wrong_group |= !group_here;
    wrong_effect |= group_here && !effect_here;
  }
  ++count.lines;
  count.named += named;
  count.group += right_group;
  count.wrong_group += wrong_group;
  count.wrong_effect += wrong_effect;
}

void run(const Plan& plan) {
  Line line(plan);
  line.show_scores();
  std::fflush(stdout);
  int found = 0;
  for (int i = 0; i < plan.clean; ++i) {
    const reanalysis::Population population = line.clean(line.batches());
    const auto result = attribution::attribute_effects(population.table);
    found += std::any_of(result.findings.begin(), result.findings.end(),
                         [&](const auto& finding) { return may_be_false(finding, plan.spread); }) ||
             (plan.spread == 0.0 && !result.differences.empty());
    if (i == 0)
      for (const auto& difference : result.differences)
        fmt::print("  clean line: {}\n", in_words(population, difference));
    if (found < 10)
      for (const auto& finding : result.findings)
        fmt::print("  clean line: {}\n", in_words(population, finding));
  }
  fmt::print("{} clean lines (batches drawn anew): something found in {}\n", plan.clean, found);
  std::map<std::string, Count> counts;
  for (const auto& [effect, parameter] : kHidden)
    for (int i = 0; i < plan.lines; ++i) {
      const auto kind = i % 2 == 0 ? CheckGroup::Kind::Station : CheckGroup::Kind::Batch;
      const int groups = kind == CheckGroup::Kind::Station ? plan.stations : plan.batches;
      const int guilty = std::uniform_int_distribution<int>(0, groups - 1)(line.random());
      const double size = plan.size * line.of_one_check(effect, parameter);
      const reanalysis::Population population = line.with({effect, size}, kind, guilty, line.batches());
      const auto result = attribution::attribute_effects(population.table);
      fmt::print("{} {:.3g}, {} {}:", effect, size, word(kind), guilty);
      for (const auto& finding : result.findings) fmt::print(" {};", in_words(population, finding));
      for (const auto& difference : result.differences) fmt::print(" {};", in_words(population, difference));
      fmt::print("{}\n", result.findings.empty() ? " no group" : "");
      std::fflush(stdout);
      count(population, result, effect, kind, guilty, plan.spread, counts[word(kind)]);
    }
  for (const auto& [kind, count] : counts)
    fmt::print("{}: {} lines, named {}, the group {}, another group {}, another effect {}\n", kind,
               count.lines, count.named, count.group, count.wrong_group, count.wrong_effect);
}

}  // namespace
}  // namespace clampd::support

int main(int argc, char** argv) {
  clampd::support::Plan plan;
  CLI::App app{"Hidden effects of simulated lines, and what is found of them."};
  app.add_option("--stations", plan.stations)->capture_default_str();
  app.add_option("--batches", plan.batches)->capture_default_str();
  app.add_option("--brakes", plan.brakes)->capture_default_str();
  app.add_option("--repeats", plan.repeats, "runs of a check")->capture_default_str();
  app.add_option("--spread", plan.spread, "of the stations' calibration; 0: all alike")
      ->capture_default_str();
  app.add_option("--size", plan.size, "of what is hidden, in standard deviations of one check")
      ->capture_default_str();
  app.add_option("--lines", plan.lines, "of each effect, in turn at a station and in a batch")
      ->capture_default_str();
  app.add_option("--clean", plan.clean, "lines without")->capture_default_str();
  app.add_option("--seed", plan.seed)->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  clampd::support::run(plan);
}
