#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace clampd::bench {

/// How good a point is. One without violation beats any with; among those with, the smaller violation wins.
struct Fitness {
  double value;
  double violation;
};

/// The defaults of MATLAB's ga() for more than five variables; for comparison only.
struct GeneticOptions {
  std::size_t population = 200;
  double elite_share = 0.05;
  double crossover_share = 0.8;  ///< of what is not elite; the rest mutates
  int stall_generations = 50;    ///< the best changed by less than `tolerance` a generation over so many
  double tolerance = 1e-6;
  std::uint64_t seed = 1;

  /// ga() gives up after so many.
  static int most_generations(std::size_t variables) { return 100 * static_cast<int>(variables); }
};

struct GeneticResult {
  std::vector<double> best;
  Fitness fitness;
  int generations = 0;
};

/// Real-coded, over [-1, 1] in each variable: fitness scaled by rank, stochastic uniform selection, scattered
/// crossover, Gaussian mutation that shrinks linearly to zero, elite kept.
GeneticResult minimise_genetically(std::size_t variables,
                                   const std::function<Fitness(std::span<const double>)>& fitness,
                                   const GeneticOptions& options);

}  // namespace clampd::bench
