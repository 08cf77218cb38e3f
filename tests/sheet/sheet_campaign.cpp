#include "tests/sheet/sheet_campaign.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>
#include <ostream>
#include <random>
#include <stdexcept>

#include <fmt/format.h>

#include "clampd/experiment/reference.hpp"
#include "clampd/identify/extended_identification.hpp"
#include "clampd/identify/method.hpp"
#include "clampd/identify/systematic_misfit.hpp"
#include "clampd/record/run.hpp"
#include "clampd/sheet/evaluation.hpp"
#include "clampd/simulation/simulate.hpp"
#include "clampd/station/evidence.hpp"
#include "clampd/station/run_collector.hpp"
#include "clampd/station/verdict.hpp"
#include "drivers/sim/simulated_brake.hpp"
#include "tests/sheet/plant_measurement.hpp"
#include "tests/support/drawn_brake.hpp"
#include "tests/support/drawn_plant.hpp"

namespace clampd::support {
namespace {

constexpr double kGuardBand = 2.0;

/// Where its encoder stands at contact, how well it reads, and how far open the check finds the brake: most
/// as another station leaves them, some anywhere, clamped ones too.
void draw_place(Draws& draws, sim::PlantConfiguration& plant) {
  plant.encoder_zero_rad = 1e4 + draws.uniform(-1.0, 1.0);
  plant.sensors.position_noise_rad = draws.log_uniform(1e-4, 5e-3);
  plant.sensors.position_quantum_rad = draws.log_uniform(1e-4, 2e-2);
  const bool is_anywhere = draws.uniform(0.0, 1.0) < 0.2;
  plant.clearance_rad = is_anywhere ? draws.uniform(-25.0, 25.0) : draws.uniform(5.0, 7.0);
}

/// Of a brake of the population in which limits are set; nothing if it does not get there.
std::optional<double> drawn_value(const Characteristic& line, Draws& draws) {
  if (line.kind->value != nullptr) return line.kind->value(draws.brake(), line.circumstances, {});
  sim::PlantConfiguration plant;
  draw_place(draws, plant);
  return measure(line, plant);
}

/// The shipped sheet, each line limited where a tenth of the brakes are beyond.
std::vector<Characteristic> limited_lines() {
  std::vector<Characteristic> lines =
      read_sheet(std::string(CLAMPD_SOURCE_DIR) + "/configs/sheet.toml").value().characteristics;
  constexpr int kPopulation = 1000;
  for (Characteristic& line : lines) {
    Draws draws(99);
    std::vector<double> values;
    for (int i = 0; i < kPopulation; ++i)
      if (const auto value = drawn_value(line, draws)) values.push_back(*value);
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

/// Takes off what a tare of half a second with these sensors gets wrong, and puts the encoder back to where
/// it stands.
Tare tare_and_place(Draws& draws, const sim::PlantConfiguration& plant, std::vector<Run>& runs) {
  const Tare tare{.samples = 500,
                  .force_sd_N = plant.sensors.force_noise_N,
                  .velocity_sd_rad_s = plant.sensors.velocity_noise_rad_s};
  std::normal_distribution<double> normal;
  const double force_N = offset_sd(tare)[0] * normal(draws.generator());
  const double velocity_rad_s = offset_sd(tare)[1] * normal(draws.generator());
  for (Run& run : runs) {
    for (double& value : run.force_N) value -= force_N;
    for (double& value : run.velocity_rad_s) value -= velocity_rad_s;
    for (double& value : run.position_rad) value += plant.encoder_zero_rad;
  }
  return tare;
}

/// What a check adds to the covariance for the tare, and for a systematic misfit; counts those that have one.
ParameterMatrix added_by_check(const std::vector<Run>& runs, const Estimate& estimate, const Tare& tare,
                               int& marked) {
  const ParameterMatrix by_tare = tare_covariance_normalised(estimate, tare);
  const SystematicMisfit misfit = systematic_misfit(runs, estimate);
  if (!misfit.counts((estimate.covariance_normalised + by_tare).diagonal().cwiseSqrt())) return by_tare;
  ++marked;
  return by_tare + misfit.covariance_normalised;
}

/// The base model with the effect of this assignment, nothing known of its size.
ExtendedParameters model_with(const std::string& assignment) {
  const Effect* effect = find_effect(assignment.substr(0, assignment.find('=')));
  if (effect == nullptr) throw std::invalid_argument("the catalogue does not have " + assignment);
  EffectValues values{effect, {}};
  for (const EffectParameter& parameter : info_of(*effect).parameters)
    values.values.push_back(parameter.role == EffectParameter::Role::Strength ? parameter.neutral
                                                                              : parameter.starts.front());
  return {{}, {values}};
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
  Draws draws(options.seed), places(options.seed + 1000);
  for (int i = 0; i < options.brakes; ++i) {
    const BrakeParameters brake = draws.brake();
    const NoiseLevels noise = draws.noise();
    sim::PlantConfiguration plant = plant_with(shipped, brake, noise, draws.generator()());
    draw_place(places, plant);
    Result<std::vector<Run>> runs =
        simulate_manoeuvre(plant, reference, {}, static_cast<std::uint16_t>(options.repeats));
    if (!runs) {
      ++campaign.not_driven;
      continue;
    }
    const Tare tare = tare_and_place(places, plant, *runs);
    const double found_rad = sim::SimulatedBrake(plant).sample().position_rad;
    const Estimate estimate = options.is_known ? identify_extended(*runs, model_with(options.effect), {})
                                               : identify_brake(options.method, *runs, {});
    if (!estimate.converged()) {
      ++campaign.not_identified;
      continue;
    }
    ++campaign.brakes;
    const int marked_before = campaign.marked;
    const ParameterMatrix added = added_by_check(*runs, estimate, tare, campaign.marked);
    const auto begin = std::chrono::steady_clock::now();
    const std::vector<CharacteristicEstimate> sheet =
        evaluate(lines, posterior_of_check(estimate, added, *runs, tare, found_rad), {});
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
