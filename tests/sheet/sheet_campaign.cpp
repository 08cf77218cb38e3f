#include "tests/sheet/sheet_campaign.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>
#include <ostream>
#include <stdexcept>

#include <fmt/format.h>

#include "clampd/experiment/reference.hpp"
#include "clampd/identify/method.hpp"
#include "clampd/identify/systematic_misfit.hpp"
#include "clampd/record/run.hpp"
#include "clampd/sheet/evaluation.hpp"
#include "clampd/simulation/simulate.hpp"
#include "clampd/station/verdict.hpp"
#include "tests/sheet/plant_measurement.hpp"
#include "tests/support/drawn_brake.hpp"

namespace clampd::support {
namespace {

constexpr double kGuardBand = 2.0;

/// The shipped sheet, each line limited where a tenth of the brakes are beyond.
std::vector<Characteristic> limited_lines() {
  std::vector<Characteristic> lines =
      read_sheet(std::string(CLAMPD_SOURCE_DIR) + "/configs/sheet.toml").value().characteristics;
  constexpr int kPopulation = 1000;
  for (Characteristic& line : lines) {
    Draws draws(99);
    std::vector<double> values;
    for (int i = 0; i < kPopulation; ++i)
      if (const auto value = line.kind->value(draws.brake(), line.circumstances, {}))
        values.push_back(*value);
    std::sort(values.begin(), values.end());
    const bool from_below = std::isfinite(line.lower);
    constexpr double kNoLimit = std::numeric_limits<double>::infinity();
    const auto quantile =
        static_cast<std::size_t>((from_below ? 0.1 : 0.9) * static_cast<double>(values.size()));
    line.lower = from_below ? values[quantile] : -kNoLimit;
    line.upper = from_below ? kNoLimit : values[quantile];
  }
  return lines;
}

void count(CharacteristicCount& counts, const Characteristic& line, const CharacteristicEstimate& estimate,
           double truth) {
  if (estimate.state != CharacteristicEstimate::State::Known) {
    ++counts.unknown;
    counts.why = estimate.why;
    return;
  }
  ++counts.known;
  const double error = std::abs(estimate.value - truth);
  counts.held += error <= 1.96 * estimate.sd;
  counts.squares += std::pow(error / estimate.sd, 2);
  counts.sd_mean += estimate.sd;
  const auto inside = [&](double value) { return value >= line.lower && value <= line.upper; };
  const bool is_wrong = inside(estimate.value) != inside(truth);
  const bool is_marginal = judge_parameter(estimate.value, estimate.sd, {line.lower, line.upper},
                                           kGuardBand) == ParameterVerdict::Marginal;
  counts.decided += !is_marginal;
  counts.marginal += is_marginal;
  (is_marginal ? counts.marginal_wrong : counts.decided_wrong) += is_wrong;
}

/// What a check adds to the covariance for a systematic misfit; counts those that do.
ParameterMatrix counted_misfit(const std::vector<Run>& runs, const Estimate& estimate, int& marked) {
  const SystematicMisfit misfit = systematic_misfit(runs, estimate);
  if (!misfit.counts(estimate.covariance_normalised.diagonal().cwiseSqrt())) return ParameterMatrix::Zero();
  ++marked;
  return misfit.covariance_normalised;
}

}  // namespace

SheetCampaign run_sheet_campaign(const SheetCampaignOptions& options) {
  const std::vector<Characteristic> lines = limited_lines();
  const Reference reference =
      build_reference(read_run(std::string(CLAMPD_SOURCE_DIR) + "/configs/trajectory.csv").value().run, {})
          .value();
  sim::PlantConfiguration shipped =
      sim::read_plant_configuration(std::string(CLAMPD_SOURCE_DIR) + "/configs/plant.toml").value();
  if (!options.effect.empty() && !sim::set_effect(shipped.effects, options.effect))
    throw std::invalid_argument("no such effect: " + options.effect);
  SheetCampaign campaign;
  for (const Characteristic& line : lines)
    campaign.characteristics.push_back(
        {.name = line.name, .limit = std::isfinite(line.lower) ? line.lower : line.upper});
  Draws draws(options.seed);
  for (int i = 0; i < options.brakes; ++i) {
    sim::PlantConfiguration plant = shipped;
    plant.brake = draws.brake();
    const NoiseLevels noise = draws.noise();
    plant.sensors.force_noise_N = noise.sensors.force_N;
    plant.sensors.velocity_noise_rad_s = noise.sensors.velocity_rad_s;
    plant.sensors.torque_noise_Nm = noise.torque_Nm;
    plant.seed = draws.generator()();
    const Result<std::vector<Run>> runs =
        simulate_manoeuvre(plant, reference, {}, static_cast<std::uint16_t>(options.repeats));
    if (!runs) {
      ++campaign.not_driven;
      continue;
    }
    const Estimate estimate = identify_brake(options.method, *runs, {});
    if (!estimate.converged()) {
      ++campaign.not_identified;
      continue;
    }
    ++campaign.brakes;
    const auto begin = std::chrono::steady_clock::now();
    const int marked_before = campaign.marked;
    const std::vector<CharacteristicEstimate> sheet =
        evaluate(lines, posterior_of(estimate, counted_misfit(*runs, estimate, campaign.marked)), {});
    campaign.evaluation_s =
        std::max(campaign.evaluation_s,
                 std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    int wrong = 0;
    for (std::size_t k = 0; k < lines.size(); ++k) {
      CharacteristicCount& counts = campaign.characteristics[k];
      const int wrong_before = counts.decided_wrong;
      if (const std::optional<double> truth = measure(lines[k], plant))
        count(counts, lines[k], sheet[k], *truth);
      wrong += counts.decided_wrong - wrong_before;
    }
    if (campaign.marked == marked_before) campaign.wrong_without_mark += wrong;
  }
  return campaign;
}

void print(std::ostream& out, const SheetCampaign& campaign) {
  out << fmt::format(
      "{} brakes, {} could not be driven, {} not identified, {} marked; a sheet took {:.1f} ms at most\n",
      campaign.brakes, campaign.not_driven, campaign.not_identified, campaign.marked,
      1e3 * campaign.evaluation_s);
  int held = 0, known = 0, decided = 0, decided_wrong = 0, marginal = 0, marginal_wrong = 0;
  for (const CharacteristicCount& c : campaign.characteristics) {
    out << fmt::format(
        "{:<76} coverage {:5.1f} % of {} (-{})  rms {:.3f} sd  sd {:.3g}  limit {:.4g}: {} decided, {} "
        "wrong; {} "
        "marginal, {} wrong\n",
        c.name, 100.0 * c.held / std::max(1, c.known), c.known, c.unknown,
        std::sqrt(c.squares / std::max(1, c.known)), c.sd_mean / std::max(1, c.known), c.limit, c.decided,
        c.decided_wrong, c.marginal, c.marginal_wrong);
    if (c.unknown > 0) out << fmt::format("  not known, once: {}\n", c.why);
    held += c.held;
    known += c.known;
    decided += c.decided;
    decided_wrong += c.decided_wrong;
    marginal += c.marginal;
    marginal_wrong += c.marginal_wrong;
  }
  out << fmt::format(
      "all: coverage {:.2f} % of {}; wrong verdicts: {} of {} decided ({:.3f} %; {} of them on "
      "sheets without a misfit mark), {} of {} marginal\n",
      100.0 * held / std::max(1, known), known, decided_wrong, decided,
      100.0 * decided_wrong / std::max(1, decided), campaign.wrong_without_mark, marginal_wrong, marginal);
}

}  // namespace clampd::support
