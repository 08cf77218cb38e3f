#include "tests/benchmarks/genetic_algorithm.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace clampd::bench {
namespace {

struct Individual {
  std::vector<double> genes;
  Fitness fitness;
};

bool better(const Individual& a, const Individual& b) {
  if (a.fitness.violation > 0.0 || b.fitness.violation > 0.0)
    return a.fitness.violation < b.fitness.violation;
  return a.fitness.value < b.fitness.value;
}

/// Parents of a sorted population: one walk of equal strides along a line on which each has a length of one
/// over the root of its rank, then shuffled.
std::vector<std::size_t> select(std::size_t population, std::size_t parents, std::mt19937_64& generator) {
  std::vector<double> end(population);
  double total = 0.0;
  for (std::size_t i = 0; i < population; ++i) end[i] = total += 1.0 / std::sqrt(static_cast<double>(i + 1));
  const double stride = total / static_cast<double>(parents);
  double position = std::uniform_real_distribution<double>(0.0, stride)(generator);
  std::vector<std::size_t> selected;
  for (std::size_t i = 0; selected.size() < parents; position += stride) {
    while (i + 1 < population && end[i] < position) ++i;
    selected.push_back(i);
  }
  std::shuffle(selected.begin(), selected.end(), generator);
  return selected;
}

}  // namespace

GeneticResult minimise_genetically(std::size_t variables,
                                   const std::function<Fitness(std::span<const double>)>& fitness,
                                   const GeneticOptions& options) {
  std::mt19937_64 generator(options.seed);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  std::normal_distribution<double> normal;
  const auto share = [](double of, std::size_t count) {
    return static_cast<std::size_t>(std::lround(of * static_cast<double>(count)));
  };
  const std::size_t elite = share(options.elite_share, options.population);
  const std::size_t crossovers = share(options.crossover_share, options.population - elite);
  const std::size_t mutations = options.population - elite - crossovers;
  const int most_generations = GeneticOptions::most_generations(variables);

  std::vector<Individual> population(options.population);
  for (Individual& individual : population) {
    individual.genes.resize(variables);
    for (double& gene : individual.genes) gene = uniform(generator);
    individual.fitness = fitness(individual.genes);
  }
  std::vector<Individual> children(options.population);
  std::vector<double> history;
  int generation = 0;
  for (;; ++generation) {
    std::sort(population.begin(), population.end(), better);
    const Fitness& best = population.front().fitness;
    history.push_back(best.violation > 0.0 ? std::numeric_limits<double>::infinity() : best.value);
    const auto stall = static_cast<std::size_t>(options.stall_generations);
    if (generation == most_generations) break;
    if (history.size() > stall &&
        history[history.size() - 1 - stall] - history.back() < options.tolerance * options.stall_generations)
      break;

    std::copy_n(population.begin(), elite, children.begin());
    const auto parents = select(options.population, 2 * crossovers + mutations, generator);
    const double spread = 1.0 - static_cast<double>(generation) / most_generations;
    for (std::size_t c = 0; c < crossovers + mutations; ++c) {
      Individual& child = children[elite + c];
      if (c < crossovers) {
        const Individual& first = population[parents[2 * c]];
        const Individual& second = population[parents[2 * c + 1]];
        child.genes.resize(variables);
        for (std::size_t i = 0; i < variables; ++i)
          child.genes[i] = (uniform(generator) < 0.0 ? first : second).genes[i];
      } else {
        child.genes = population[parents[crossovers + c]].genes;
        for (double& gene : child.genes) gene = std::clamp(gene + spread * normal(generator), -1.0, 1.0);
      }
      child.fitness = fitness(child.genes);
    }
    population.swap(children);
  }
  return {population.front().genes, population.front().fitness, generation};
}

}  // namespace clampd::bench
