#include "clampd/diagnose/settle.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "clampd/experiment/discrimination.hpp"

namespace clampd {

namespace {

constexpr std::ptrdiff_t kMaxRivalsListed = 3;
/// Expected of one round; three rounds of it settle most doubts, and a wrong decision it makes none.
constexpr double kWorthIt_nats = 4.0;

Result<Discrimination> design_between(std::span<const Diagnosis::Rival> group, const NoiseLevels& noise,
                                      const BrakeParameters& nominal, std::size_t runs_so_far) {
  std::vector<RivalModel> rivals;
  for (const Diagnosis::Rival& rival : group) rivals.push_back({rival.name, rival.model, rival.covariance});
  DiscriminationOptions options;
  options.run_number = static_cast<double>(runs_so_far);
  options.enough_nats = kWorthIt_nats;
  return design_discrimination(rivals, noise, nominal, options);
}

std::string how_it_ended(const Settlement& settlement, const NextStep& left) {
  const auto experiments = settlement.experiments.size();
  const std::string after = experiments == 0   ? ""
                            : experiments == 1 ? " after one experiment"
                                               : fmt::format(" after {} experiments", experiments);
  if (settlement.diagnosis.verdict == DiagnosisVerdict::Unexplained && experiments > 0)
    return fmt::format("not settled{}: no known effect explains all of the runs now", after);
  if (settlement.diagnosis.verdict != DiagnosisVerdict::Ambiguous)
    return experiments == 0 ? "there is nothing to settle" : "settled" + after;
  if (!left.experiment && !left.words.empty()) return fmt::format("not settled{}: {}", after, left.words);
  return fmt::format("not settled{}", after);
}

}  // namespace

NextStep next_step_for(const Diagnosis& diagnosis, const BrakeParameters& nominal, std::size_t runs_so_far) {
  NextStep step;
  if (diagnosis.verdict != DiagnosisVerdict::Ambiguous) return step;
  for (const std::vector<Diagnosis::Rival>& group : diagnosis.rival_models) {
    if (group.size() < 2) continue;
    std::vector<Diagnosis::Rival> rivals(group.begin(),
                                         group.begin() + std::min(std::ssize(group), kMaxRivalsListed));
    Result<Discrimination> design = design_between(rivals, diagnosis.noise_after, nominal, runs_so_far);
    std::string words = design ? design->why : design.error().message;
    if (design && !design->settles && rivals.size() > 2) {
      // Two of them are twins; whether it is one of those or another may still be told.
      rivals.erase(rivals.begin() + static_cast<std::ptrdiff_t>(design->second));
      design = design_between(rivals, diagnosis.noise_after, nominal, runs_so_far);
      if (design && design->settles) words += "; but " + design->why;
    }
    if (!step.words.empty()) step.words += "; ";
    step.words += words;
    if (!design || !design->settles) continue;
    step.words = words;
    step.experiment = NextExperiment{design->name, words, design->trajectory, design->repeats,
                                     design->expected_evidence_nats};
    break;
  }
  return step;
}

std::optional<NextExperiment> next_experiment_for(const Diagnosis& diagnosis,
                                                  const BrakeParameters& nominal) {
  return next_step_for(diagnosis, nominal).experiment;
}

Result<Settlement> settle(Diagnosis diagnosis, std::span<const Run> runs, const Drive& drive,
                          const SettleOptions& options) {
  Settlement settlement{std::move(diagnosis), {runs.begin(), runs.end()}, {}, {}};
  NextStep step;
  for (int round = 0; settlement.diagnosis.verdict == DiagnosisVerdict::Ambiguous; ++round) {
    step = next_step_for(settlement.diagnosis, options.diagnose.nominal, settlement.runs.size());
    if (!step.experiment || round == options.most_rounds) break;
    if (options.announce) options.announce(*step.experiment);
    Result<std::vector<Run>> driven = drive(step.experiment->trajectory, step.experiment->repeats);
    if (!driven) return tl::unexpected(driven.error());
    std::move(driven->begin(), driven->end(), std::back_inserter(settlement.runs));
    settlement.experiments.push_back(std::move(*step.experiment));
    step = {};
    Result<Diagnosis> anew = diagnose(settlement.runs, options.diagnose);
    if (!anew) return tl::unexpected(anew.error());
    settlement.diagnosis = std::move(*anew);
  }
  settlement.diagnosis.next_experiment = step.experiment;
  settlement.words = how_it_ended(settlement, step);
  return settlement;
}

}  // namespace clampd
