#include <algorithm>
#include <cmath>
#include <numbers>

#include "clampd/identify/spikes.hpp"
#include "src/diagnose/evidence.hpp"
#include "src/diagnose/hypothesis.hpp"

namespace clampd::diagnosing {

namespace {

constexpr int kMaxRounds = 8;
/// Spikes stand alone; where more than this share has a neighbour, something else is wrong.
constexpr double kMaxNeighbours = 0.3;
constexpr double kMaxShare = 0.2;

struct Spike {
  std::size_t run, row;
};

class SpikeSearch {
 public:
  SpikeSearch(const Hypothesis& hypothesis, int channel) : channel_(channel), found_(hypothesis) {}

  bool run(std::span<const FilteredRun> first) {
    std::vector<FilteredRun> filtered;
    for (int round = 0; round < kMaxRounds; ++round) {
      if (round > 0) filtered = filter_runs(found_.runs, found_.estimate, found_.threads);
      const std::span<const FilteredRun> now = round > 0 ? filtered : first;
      if (now.empty() || !mark(now)) break;
      if (static_cast<double>(spikes_.size()) > kMaxShare * readings() || !stand_alone()) return false;
      refit(found_);
      if (!found_.possible()) return false;
    }
    return !spikes_.empty() && stand_alone();
  }

  /// The spikes as a mixture: a share of the readings has a far larger noise.
  Hypothesis result(const Effect& effect) {
    const std::vector<FilteredRun> filtered = filter_runs(found_.runs, found_.estimate, found_.threads);
    const double marked = static_cast<double>(spikes_.size());
    const double share = marked / readings();
    double square = 0.0;
    for (const Spike& spike : spikes_) square += std::pow(residual(filtered, spike), 2) / marked;
    double likelihood = marked * std::log(share) + (readings() - marked) * std::log1p(-share);
    for (const Spike& spike : spikes_)
      likelihood -=
          0.5 * (std::log(2.0 * std::numbers::pi * square) + std::pow(residual(filtered, spike), 2) / square);
    found_.unused_log_likelihood += likelihood;
    found_.estimate =
        with_effect(found_.estimate, {&effect, {share, std::sqrt(square), 1.0 + channel_}});
    // Without equations: the covariance holds.
    return std::move(found_);
  }

 private:
  const std::vector<double>& innovations(const FilteredRun& run) const {
    return channel_ == 0 ? run.force : run.velocity;
  }
  std::vector<std::uint8_t>& use(std::size_t run) {
    return channel_ == 0 ? found_.runs[run].use_force : found_.runs[run].use_velocity;
  }
  double residual(const std::vector<FilteredRun>& filtered, const Spike& spike) const {
    const FitRun& run = found_.runs[spike.run];
    const FilteredRun& view = filtered[spike.run];
    return channel_ == 0 ? run.force_N[spike.row] - view.predicted_force_N[spike.row]
                         : run.velocity_rad_s[spike.row] - view.predicted_velocity_rad_s[spike.row];
  }
  bool stand_alone() const {
    std::size_t with_neighbour = 0;
    for (const Spike& spike : spikes_)
      with_neighbour += std::any_of(spikes_.begin(), spikes_.end(), [&](const Spike& other) {
        return other.run == spike.run && (other.row == spike.row + 1 || other.row + 1 == spike.row);
      });
    return static_cast<double>(with_neighbour) <= kMaxNeighbours * static_cast<double>(spikes_.size());
  }
  double readings() const {
    double count = 0.0;
    for (const FitRun& run : found_.runs) count += static_cast<double>(run.size());
    return count;
  }

  bool mark(std::span<const FilteredRun> filtered) {
    std::vector<double> all;
    for (const FilteredRun& run : filtered)
      all.insert(all.end(), innovations(run).begin(), innovations(run).end());
    const double limit = spike_limit(std::move(all));
    bool any = false;
    for (std::size_t r = 0; r < filtered.size(); ++r) {
      for (const std::size_t row : spikes_in(innovations(filtered[r]), limit)) {
        use(r)[row] = 0;
        spikes_.push_back({r, row});
        any = true;
      }
    }
    return any;
  }

  int channel_;
  Hypothesis found_;
  std::vector<Spike> spikes_;
};

}  // namespace

Candidate look_for_spikes(const Effect& effect, const Hypothesis& hypothesis, std::span<const FilteredRun> filtered) {
  Candidate best;
  best.effect = &effect;
  best.degrees = 2.0;
  best.alternatives = 2.0;
  best.is_fitted = true;
  for (int channel = 0; channel < 2; ++channel) {
    SpikeSearch search(hypothesis, channel);
    if (!search.run(filtered)) continue;
    Hypothesis found = search.result(effect);
    found.degrees += best.degrees;
    const double gain = found.log_likelihood() - hypothesis.log_likelihood();
    if (gain <= best.gain) continue;
    best.gain = best.predicted_gain = gain;
    best.fitted = std::move(found);
  }
  best.significance_nats = best.predicted_significance_nats =
      significance_of(best.gain, best.degrees, best.alternatives);
  return best;
}

}  // namespace clampd::diagnosing
