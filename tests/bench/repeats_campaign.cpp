#include "tests/bench/repeats_campaign.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <iostream>
#include <random>
#include <stdexcept>
#include <thread>
#include <utility>

#include <fmt/format.h>

#include "clampd/bench/builtin.hpp"
#include "clampd/bench/embedded_station.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "drivers/sim/effects.hpp"
#include "drivers/sim/plant_configuration.hpp"

namespace clampd::support {

namespace {

constexpr int kLimits = 2 * static_cast<int>(kParameterCount);
constexpr std::uint32_t kFixedRepeats = 20;

class Campaign {
 public:
  explicit Campaign(const RepeatsCampaignOptions& options) : options_(options), station_(prepare()) {
    plant_ = sim::parse_plant_configuration(bench::kBuiltinPlant, "plant.toml").value();
    plant_.sensors.force_noise_N *= options.noise;
    plant_.sensors.velocity_noise_rad_s *= options.noise;
    plant_.sensors.torque_noise_Nm *= options.noise;
    // Limits are near by what the noise does; what the model lacks comes on top.
    for (int limit = 0; limit < kLimits; ++limit) sd_at_[static_cast<std::size_t>(limit)] = sd_at(limit);
    if (!options.effect.empty() && !sim::set_effect(plant_.effects, options.effect))
      throw std::invalid_argument("no such effect: " + options.effect);
  }

  BrakeResult check(int index) const {
    std::seed_seq seeds{options_.seed, static_cast<std::uint64_t>(index)};
    std::mt19937_64 random(seeds);
    BrakeResult result;
    sim::PlantConfiguration plant = draw(index, random, result);
    plant.seed = random();
    result.automatic = by(plant, {.serial = "AUTO", .repeats_auto = true});
    if (result.nearness != Nearness::Far || index % options_.fixed_every == 0)
      result.fixed = by(plant, {.serial = "FIXED", .repeats = kFixedRepeats});
    return result;
  }

 private:
  bench::PreparedStation prepare() const {
    StationConfiguration configuration;
    configuration.check.repeats_most = options_.most;
    if (!options_.chooses) configuration.check.further_trajectories.emplace();
    configuration.check.diagnose =
        false;  // of the cause; it changes no verdict by limits but for the station's own faults
    return bench::prepare_station(configuration).value();
  }

  double value_of(int limit) const {
    const LimitInterval& interval = station_.limits.intervals[static_cast<std::size_t>(limit / 2)];
    return limit % 2 == 0 ? interval.lower : interval.upper;
  }

  /// What a fixed check of a brake just there reports.
  double sd_at(int limit) const {
    sim::PlantConfiguration plant = plant_;
    plant.brake.theta[limit / 2] = value_of(limit);
    bench::EmbeddedStation station(station_, plant);
    const CheckRecord record =
        station.run_check({.serial = "SD", .repeats = kFixedRepeats}, nullptr, nullptr).value();
    if (record.parameters.empty())
      throw std::runtime_error("a brake at a limit of " +
                               std::string(kParameterTable[static_cast<std::size_t>(limit / 2)].name) +
                               " cannot be checked: " + record.reason);
    return record.parameters[static_cast<std::size_t>(limit / 2)].sd;
  }

  sim::PlantConfiguration draw(int index, std::mt19937_64& random, BrakeResult& result) const {
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    sim::PlantConfiguration plant = plant_;
    for (double& value : plant.brake.theta) value *= 0.87 + 0.26 * uniform(random);
    const double kind = uniform(random);
    const double place = uniform(random);
    if (kind < options_.near_share)
      result.nearness = Nearness::Near;
    else if (kind < options_.near_share + options_.beyond_share)
      result.nearness = Nearness::Beyond;
    if (result.nearness != Nearness::Far) {
      result.limit = index % kLimits;
      const double half_width = options_.near_sd * sd_at_[static_cast<std::size_t>(result.limit)];
      const double outward = result.limit % 2 == 0 ? -1.0 : 1.0;
      const double off = result.nearness == Nearness::Near ? 2.0 * place - 1.0 : 1.0 + 0.5 * place;
      plant.brake.theta[result.limit / 2] = value_of(result.limit) + outward * off * half_width;
    }
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const double value = plant.brake.theta[static_cast<Eigen::Index>(i)];
      const LimitInterval& limits = station_.limits.intervals[i];
      result.is_good = result.is_good && value >= limits.lower && value <= limits.upper;
    }
    return plant;
  }

  PlanResult by(const sim::PlantConfiguration& plant, const CheckRequest& request) const {
    bench::EmbeddedStation station(station_, plant);
    const CheckRecord record = station.run_check(request, nullptr, nullptr).value();
    return {
        true,           record.verdict,    record.marginal, record.systematic && record.systematic->marked,
        record.repeats, record.duration_s, record.reason};
  }

  RepeatsCampaignOptions options_;
  bench::PreparedStation station_;
  sim::PlantConfiguration plant_;
  std::array<double, kLimits> sd_at_{};
};

double quantile(std::vector<double> sorted, double share) {
  if (sorted.empty()) return 0.0;
  std::sort(sorted.begin(), sorted.end());
  return sorted[std::min(sorted.size() - 1,
                         static_cast<std::size_t>(share * static_cast<double>(sorted.size())))];
}

void print_errors(std::ostream& out, const RepeatsCampaign& campaign) {
  out << fmt::format("{:<8}{:<7}{:>8}{:>15}{:>15}{:>19}{:>19}{:>10}{:>12}{:>8}\n", "brakes", "plan",
                     "checked", "wrong accepts", "wrong rejects", "unmarked accepts", "unmarked rejects",
                     "marginal", "no verdict", "misfit");
  for (const auto& [nearness, words] :
       {std::pair{Nearness::Near, "near"}, {Nearness::Beyond, "beyond"}, {Nearness::Far, "far"}})
    for (const auto& [plan, name] :
         {std::pair{&BrakeResult::automatic, "auto"}, {&BrakeResult::fixed, "fixed"}}) {
      const Errors e = errors_of(campaign, plan, nearness);
      out << fmt::format("{:<8}{:<7}{:>8}{:>15}{:>15}{:>19}{:>19}{:>10}{:>12}{:>8}\n", words, name, e.checked,
                         e.wrong_accepts, e.wrong_rejects, e.unmarked_accepts, e.unmarked_rejects, e.marginal,
                         e.no_verdict, e.misfit_marked);
    }
}

void print_curve(std::ostream& out, const RepeatsCampaign& campaign) {
  const auto all = static_cast<double>(campaign.brakes.size());
  int ended = 0, wrong = 0;
  out << fmt::format("{:<6}{:>9}{:>20}{:>18}\n", "runs", "ended, %", "bench time, s", "wrong so far, %");
  for (std::uint32_t n = 1; n <= campaign.options.most; ++n) {
    double time_s = 0.0;
    int here = 0;
    for (const BrakeResult& brake : campaign.brakes) {
      if (brake.automatic.repeats != n) continue;
      ++here;
      time_s += brake.automatic.duration_s;
      wrong += is_about_the_brake(brake.automatic.verdict) &&
               (brake.automatic.verdict == Verdict::Pass) != brake.is_good;
    }
    ended += here;
    if (here > 0)
      out << fmt::format("{:<6}{:>9.2f}{:>20.2f}{:>18.3f}\n", n, 100.0 * ended / all, time_s / here,
                         100.0 * wrong / all);
  }
}

/// Checks whose verdict came without a mark, and is wrong, by the limit that they are near.
void print_limits(std::ostream& out, const RepeatsCampaign& campaign) {
  for (int limit = 0; limit < kLimits; ++limit) {
    int brakes = 0, wrong = 0, unmarked = 0;
    double repeats = 0.0;
    for (const BrakeResult& brake : campaign.brakes) {
      if (brake.nearness != Nearness::Near || brake.limit != limit) continue;
      ++brakes;
      repeats += brake.automatic.repeats;
      const bool is_wrong = is_about_the_brake(brake.automatic.verdict) &&
                            (brake.automatic.verdict == Verdict::Pass) != brake.is_good;
      wrong += is_wrong;
      unmarked += is_wrong && !brake.automatic.marginal;
    }
    if (brakes > 0)
      out << fmt::format(
          "near {} limit of {:<4} {:>5} brakes, {:>5.1f} runs on average, {} wrong, {} of them unmarked\n",
          limit % 2 == 0 ? "lower" : "upper", kParameterTable[static_cast<std::size_t>(limit / 2)].name,
          brakes, repeats / brakes, wrong, unmarked);
  }
}

}  // namespace

Errors errors_of(const RepeatsCampaign& campaign, PlanResult BrakeResult::*plan, Nearness nearness) {
  Errors errors;
  for (const BrakeResult& brake : campaign.brakes) {
    const PlanResult& result = brake.*plan;
    if (brake.nearness != nearness || !result.checked) continue;
    ++errors.checked;
    errors.marginal += result.marginal;
    errors.misfit_marked += result.misfit_marked;
    errors.no_verdict += !is_about_the_brake(result.verdict);
    const bool accept = result.verdict == Verdict::Pass && !brake.is_good;
    const bool reject = result.verdict == Verdict::Fail && brake.is_good;
    errors.wrong_accepts += accept;
    errors.wrong_rejects += reject;
    errors.unmarked_accepts += accept && !result.marginal;
    errors.unmarked_rejects += reject && !result.marginal;
  }
  return errors;
}

RepeatsCampaign run_repeats_campaign(const RepeatsCampaignOptions& options) {
  const Campaign campaign(options);
  RepeatsCampaign results{std::vector<BrakeResult>(static_cast<std::size_t>(options.brakes)), options};
  std::atomic<int> next{0};
  const auto work = [&] {
    for (int i = next++; i < options.brakes; i = next++)
      results.brakes[static_cast<std::size_t>(i)] = campaign.check(i);
  };
  std::vector<std::jthread> others;
  for (int t = 1; t < options.threads; ++t) others.emplace_back(work);
  work();
  others.clear();
  return results;
}

void print(std::ostream& out, const RepeatsCampaign& campaign) {
  const RepeatsCampaignOptions& o = campaign.options;
  out << fmt::format(
      "{} brakes, seed {}: {:.0f} % within {:.2f} sd of 20 repeats of a limit, {:.0f} % beyond; noise {:g}; "
      "{} "
      "runs at most\n\n",
      o.brakes, o.seed, 100.0 * o.near_share, o.near_sd, 100.0 * o.beyond_share, o.noise, o.most);
  print_errors(out, campaign);
  std::vector<double> times, fixed_times;
  for (const BrakeResult& brake : campaign.brakes) {
    times.push_back(brake.automatic.duration_s);
    if (brake.fixed.checked) fixed_times.push_back(brake.fixed.duration_s);
  }
  out << fmt::format(
      "\nbench time: median {:.2f} s, 95 % {:.2f} s, longest {:.2f} s; of 20 fixed repeats: median {:.2f} "
      "s\n\n",
      quantile(times, 0.5), quantile(times, 0.95), quantile(times, 1.0), quantile(fixed_times, 0.5));
  print_curve(out, campaign);
  out << '\n';
  print_limits(out, campaign);
  for (const BrakeResult& brake : campaign.brakes)
    if (!is_about_the_brake(brake.automatic.verdict))
      out << fmt::format(
          "no verdict: {}{}\n", brake.automatic.reason,
          brake.fixed.checked ? fmt::format(" (20 fixed repeats: {})", to_string(brake.fixed.verdict)) : "");
}

}  // namespace clampd::support
