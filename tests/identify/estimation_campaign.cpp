#include "tests/identify/estimation_campaign.hpp"

#include <cmath>
#include <iostream>
#include <optional>
#include <stdexcept>

#include <fmt/format.h>

#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/identify/profile.hpp"
#include "clampd/simulation/simulate.hpp"
#include "drivers/sim/effects.hpp"
#include "support/drawn_brake.hpp"
#include "support/drawn_plant.hpp"
#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd::support {

namespace {

class Runs {
 public:
  explicit Runs(const CampaignOptions& options) : options_(options) {
    const std::string file = options.trajectory.empty()
                                 ? std::string(CLAMPD_SOURCE_DIR) + "/configs/trajectory.csv"
                                 : options.trajectory;
    const Run optimal = read_run(file).value().run;
    const bool slow = options.bench == Bench::Sinusoid;
    reference_ =
        build_reference(make_manoeuvre(slow ? "slow-sinusoid" : "optimal", {}, optimal).value(), {}).value();
    plant_ = sim::read_plant_configuration(std::string(CLAMPD_SOURCE_DIR) + "/configs/plant.toml").value();
    if (!options.effect.empty() && !sim::set_effect(plant_.effects, options.effect))
      throw std::invalid_argument("no such effect: " + options.effect);
  }

  std::optional<std::vector<Run>> of(const BrakeParameters& brake, const NoiseLevels& noise, Draws& draws) {
    if (options_.bench != Bench::Reference) {
      const sim::PlantConfiguration plant = plant_with(plant_, brake, noise, draws.generator()());
      auto runs = simulate_manoeuvre(plant, reference_, {}, static_cast<std::uint16_t>(options_.repeats));
      if (!runs) return std::nullopt;
      return std::move(*runs);
    }
    std::vector<Run> runs;
    for (int r = 0; r < options_.repeats; ++r)
      runs.push_back(
          run_reference_brake(brake, BrakeState::Zero(), strong_torque(), noise, draws.generator()).run);
    return runs;
  }

 private:
  const CampaignOptions& options_;
  Reference reference_;
  sim::PlantConfiguration plant_;
};

void count(Coverage& coverage, bool held) {
  ++coverage.given;
  coverage.held += held;
}

void judge(const Estimate& estimate, Method asked, const BrakeParameters& truth, const std::string& brake,
           MethodCampaign& campaign) {
  if (!estimate.converged()) {
    campaign.no_result += estimate.termination == Termination::Unexplained;
    for (Coverage& coverage : campaign.by_sd) ++coverage.unknown;
    campaign.remarks.push_back(fmt::format("{}: {}: {}", brake, to_string(asked), estimate.message));
    return;
  }
  ++campaign.converged;
  if (estimate.method != asked) {
    ++campaign.other_method;
    campaign.remarks.push_back(fmt::format("{}: {}: {}", brake, to_string(asked), estimate.message));
  }
  const ParameterVector error = normalised_error(estimate.parameters, truth);
  const double distance =
      error.cwiseAbs().cwiseQuotient(estimate.covariance_normalised.diagonal().cwiseSqrt()).maxCoeff();
  if (!(distance < kLost)) {
    ++campaign.lost;
    campaign.remarks.push_back(fmt::format("{}: {}: lost, {:.1f} sd off, residual {:.1f} N, {:.2f} rad/s",
                                           brake, to_string(asked), distance, estimate.force_rms_N,
                                           estimate.velocity_rms_rad_s));
  }
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    count(campaign.by_sd[i], std::abs(error[k]) <= 1.96 * std::sqrt(estimate.covariance_normalised(k, k)));
  }
}

}  // namespace

std::array<double, 2> Coverage::wilson() const {
  constexpr double z = 1.96;
  const double n = given;
  if (given == 0) return {0.0, 1.0};
  const double centre = (rate() + z * z / (2.0 * n)) / (1.0 + z * z / n);
  const double half = z / (1.0 + z * z / n) * std::sqrt(rate() * (1.0 - rate()) / n + z * z / (4.0 * n * n));
  return {centre - half, centre + half};
}

Campaign run_estimation_campaign(const CampaignOptions& options) {
  Campaign campaign;
  Draws draws(options.seed);
  Runs bench(options);
  for (int check = 0; check < options.checks; ++check) {
    const BrakeParameters truth = draws.brake();
    const NoiseLevels noise = draws.noise();
    EstimatorOptions settings;
    if (options.far_starts)
      for (double& value : settings.start.theta) value *= draws.uniform(0.5, 1.5);
    const auto runs = bench.of(truth, noise, draws);
    if (!runs) {
      ++campaign.undriven;
      continue;
    }
    ++campaign.checks;
    const std::string brake =
        fmt::format("check {} ({:.0f} N, {:.2f} rad/s, {:.1f} mN m)", check, noise.sensors.force_N,
                    noise.sensors.velocity_rad_s, 1e3 * noise.torque_Nm);
    for (const Method method : {Method::OutputError, Method::PredictionError}) {
      MethodCampaign& of_method = campaign.methods[static_cast<std::size_t>(method)];
      const Estimate estimate = identify_brake(method, *runs, settings);
      judge(estimate, method, truth, brake, of_method);
      for (int i = 0; i < options.profiles; ++i) {
        const auto parameter = static_cast<Parameter>((check + i) % static_cast<int>(kParameterCount));
        Coverage& coverage = of_method.by_profile[parameter];
        if (!estimate.converged()) {
          ++coverage.unknown;
          continue;
        }
        const Profile profile = profile_likelihood(parameter, estimate.method, *runs, settings, estimate);
        const double value = truth.theta[static_cast<Eigen::Index>(parameter)];
        if (profile.converged)
          count(coverage, profile.lower <= value && value <= profile.upper);
        else
          ++coverage.unknown;
      }
    }
  }
  return campaign;
}

void print(std::ostream& out, const Campaign& campaign) {
  out << campaign.checks << " checks, " << campaign.undriven << " brakes that could not be driven\n";
  for (const Method method : {Method::OutputError, Method::PredictionError}) {
    const MethodCampaign& of_method = campaign.methods[static_cast<std::size_t>(method)];
    out << fmt::format("{}: {} converged, {} answered by the other method, {} without result, {} lost\n",
                       to_string(method), of_method.converged, of_method.other_method, of_method.no_result,
                       of_method.lost);
    for (const auto& [name, table] :
         {std::pair{"value +- 1.96 sd", &of_method.by_sd}, std::pair{"profile", &of_method.by_profile}}) {
      if (table->front().given + table->front().unknown == 0) continue;
      out << fmt::format("  {:<17}", name);
      for (std::size_t i = 0; i < kParameterCount; ++i) {
        const Coverage& coverage = (*table)[i];
        const auto [low, high] = coverage.wilson();
        out << fmt::format("  {} {:.1f} % ({:.1f}..{:.1f})", kParameterTable[i].name, 100.0 * coverage.rate(),
                           100.0 * low, 100.0 * high);
        if (coverage.unknown > 0) out << fmt::format(" -{}", coverage.unknown);
      }
      out << '\n';
    }
  }
}

}  // namespace clampd::support
