// Lines of many stations with hidden causes, of which it counts what attribute() names; and what a large line
// costs.
//
//   factory_campaign [lines] [seed] [brakes of a station, about] [brakes of the large line, 0: none]

#include <chrono>
#include <cstdlib>
#include <fstream>

#include <fmt/format.h>

#include "clampd/attribution/attribution.hpp"
#include "support/factory.hpp"

namespace clampd::attribution {
namespace {

enum class Hidden { Nothing, Step, Drift };

struct Count {
  int lines = 0, right = 0, other_station = 0, batch = 0;
};

Count count(Hidden hidden, int lines, std::uint64_t seed, int brakes_of_a_station) {
  Count count;
  for (int i = 0; i < lines; ++i) {
    std::mt19937_64 random(seed + static_cast<std::uint64_t>(i));
    std::uniform_real_distribution<double> uniform;
    support::Factory factory;
    factory.stations = 10 + static_cast<int>(31 * uniform(random));
    factory.batches = 20 + static_cast<int>(100 * uniform(random));
    factory.brakes = factory.stations * static_cast<int>(brakes_of_a_station * (0.5 + uniform(random)));
    factory.checked_twice = 0.02 + 0.1 * uniform(random);
    factory.deviations = {.repeat = 0.3 * uniform(random),
                          .brake = 1.0,
                          .batch = 0.2 + uniform(random),
                          .station = 0.2 + 0.4 * uniform(random),
                          .fixture = 0.0,
                          .period = 0.2 * uniform(random),
                          .wander = uniform(random) < 0.5 ? 0.0 : 0.1 * uniform(random)};
    factory.identification = 0.1 + 0.4 * uniform(random);
    const int station = static_cast<int>(factory.stations * uniform(random));
    const double size = (uniform(random) < 0.5 ? -1.0 : 1.0) * factory.deviations.station;
    if (hidden == Hidden::Step) {
      factory.step_station = station;
      factory.step = size;
      factory.step_at = 0.2 + 0.6 * uniform(random);
    } else if (hidden == Hidden::Drift) {
      factory.drift_station = station;
      factory.drift = 2.0 * size;  // one deviation on either side of the middle
    }
    const LineTable table = support::make_line(factory, seed + 1000 + static_cast<std::uint64_t>(i));
    ++count.lines;
    bool named = false, other = false, batch = false;
    const LineAttribution found = attribute(table, {});
    for (const Finding& finding : found.parameters[0].findings) {
      if (finding.kind == Finding::Kind::BatchApart)
        batch = true;
      else if (hidden != Hidden::Nothing && finding.number == station)
        named = true;
      else
        other = true;
    }
    count.right += named ? 1 : 0;
    count.other_station += other ? 1 : 0;
    count.batch += batch ? 1 : 0;
  }
  return count;
}

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

/// Seven parameters, in a file of the stations' format.
void write_large_line(const std::string& file, int brakes) {
  support::Factory factory;
  factory.stations = 40;
  factory.batches = brakes / 1000;
  factory.brakes = brakes;
  factory.checked_twice = 0.0;
  LineTable table = support::make_line(factory, 1);
  std::ofstream out(file);
  out << "record,serial,batch,station,started,verdict";
  for (int p = 0; p < 7; ++p) out << fmt::format(",p{0} [u],p{0} sd [u]", p);
  out << '\n';
  for (std::size_t i = 0; i < table.checks(); ++i) {
    const int second =
        static_cast<int>(86400.0 * static_cast<double>(i) / static_cast<double>(table.checks()));
    out << fmt::format("R{},S{},B{},S{},2026-11-20T{:02}:{:02}:{:02}.000Z,PASS", i, table.layout.brake[i],
                       table.layout.batch[i], table.layout.station[i], second / 3600, second / 60 % 60,
                       second % 60);
    for (int p = 0; p < 7; ++p)
      out << fmt::format(",{:.8g},{:.4g}", table.parameters[0].values[i] + p,
                         table.parameters[0].deviations[i]);
    out << '\n';
  }
}

}  // namespace
}  // namespace clampd::attribution

int main(int argc, char** argv) {
  using namespace clampd::attribution;
  const int lines = argc > 1 ? std::atoi(argv[1]) : 30;
  const std::uint64_t seed = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
  const int brakes_of_a_station = argc > 3 ? std::atoi(argv[3]) : 500;
  const int brakes = argc > 4 ? std::atoi(argv[4]) : 0;
  fmt::print("{:<10}{:>8}{:>16}{:>16}{:>10}\n", "hidden", "lines", "right station", "other station",
             "a batch");
  for (const auto& [hidden, name] : {std::pair(Hidden::Nothing, "nothing"), std::pair(Hidden::Step, "step"),
                                     std::pair(Hidden::Drift, "drift")}) {
    const Count counted = count(hidden, lines, seed, brakes_of_a_station);
    fmt::print("{:<10}{:>8}{:>16}{:>16}{:>10}\n", name, counted.lines, counted.right, counted.other_station,
               counted.batch);
  }
  if (brakes > 0) {
    const std::string file = "large_line.csv";
    write_large_line(file, brakes);
    const auto start = std::chrono::steady_clock::now();
    const auto table = read_line_table({file});
    if (!table) return fmt::print("{}\n", table.error().message), 1;
    const double read = seconds_since(start);
    const LineAttribution found = attribute(*table, {});
    fmt::print("{} checks, 40 stations, 7 parameters: read in {:.1f} s, attributed in {:.1f} s\n",
               table->checks(), read, seconds_since(start) - read);
    for (const ParameterAttribution& parameter : found.parameters)
      fmt::print("{}: brake {:.4f} batch {:.4f} station {:.4f} time {:.4f} converged {}\n", parameter.name,
                 parameter.deviations.brake, parameter.deviations.batch, parameter.deviations.station,
                 parameter.deviations.period, parameter.converged);
  }
  return 0;
}
