#pragma once

#include <span>
#include <string>
#include <vector>

#include "clampd/experiment/discrimination.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/identify/extended_fit.hpp"
#include "closed_loop.hpp"

namespace clampd {

/// Rivals as the search compares them. One object serves all threads.
class RivalComparison {
 public:
  /// Everything must be valid and outlive this.
  RivalComparison(std::span<const RivalModel> rivals, const NoiseLevels& noise,
                  const BrakeParameters& nominal, const DiscriminationOptions& options);

  /// `relinearisations`: how often a rival's parameters are moved to where they answer best, and the rest
  /// looked at again from there; 0: judged by the derivatives at its estimate.
  DiscriminationValue evaluate(const Reference& reference, int relinearisations) const;

  /// Of the two hardest to tell apart after so many runs.
  double evidence_after(const Reference& reference, int repeats, int relinearisations) const;

 private:
  /// Readings that one rival would give, as recorded; how far it is from the limits.
  struct Tracked {
    std::vector<FitRun> runs;
    std::string infeasible;
  };
  Tracked track(const Reference& reference, const RivalModel& rival) const;
  struct Evidence {
    double of_one = 0.0, of_many = 0.0;
    double largest_innovation = 0.0;
  };
  Evidence against(const std::vector<FitRun>& runs, std::size_t rival, int repeats,
                   int relinearisations) const;
  Evidence hardest(const Reference& reference, int repeats, int relinearisations,
                   DiscriminationValue& value) const;

  std::span<const RivalModel> rivals_;
  std::vector<Eigen::MatrixXd> prior_information_;
  NoiseLevels noise_;
  DiscriminationOptions options_;
  ClosedLoop loop_;
};

/// For figures that are reported.
inline constexpr int kCarefulRelinearisations = 4;

/// Runs of this length that make about three seconds.
int repeats_in_budget(std::size_t rows, const DiscriminationOptions& options);

Result<void> check_rivals(std::span<const RivalModel> rivals);

}  // namespace clampd
