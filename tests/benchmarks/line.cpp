// Variance components of the same checks by attribute()'s model and by lme4, and what a line of a million
// checks costs.

#include <chrono>
#include <cstdio>
#include <fstream>

#include <fmt/format.h>

#include "clampd/attribution/crossed_effects.hpp"
#include "support/factory.hpp"
#include "support/temporary_directory.hpp"

namespace {

using namespace clampd;

/// The checks as `clampctl results --csv` writes them; equal parts of the time for each.
void write_checks(const std::string& file, const attribution::LineTable& table) {
  std::ofstream out(file);
  out << "serial,batch,station,started,verdict,p0 [u],p0 sd [u]\n";
  for (std::size_t i = 0; i < table.checks(); ++i) {
    const int second =
        static_cast<int>(86399.0 * static_cast<double>(i) / static_cast<double>(table.checks() - 1));
    out << fmt::format("S{},B{},S{},2026-11-20T{:02}:{:02}:{:02}.000Z,PASS,{:.10g},0\n",
                       table.layout.brake[i], table.layout.batch[i], table.layout.station[i], second / 3600,
                       second / 60 % 60, second % 60, table.parameters[0].values[i]);
  }
}

void print_row(const char* who, double brake, double batch, double station, double period, double wander,
               double repeat, double seconds) {
  fmt::print("{:<10}{:>9.4f}{:>9.4f}{:>9.4f}{:>9.4f}{:>16.4f}{:>9.4f}{:>9.2f} s\n", who, brake, batch,
             station, period, wander, repeat, seconds);
}

}  // namespace

int main() {
  support::Factory factory;
  factory.brakes = 18000;
  factory.identification = 0.0;
  factory.deviations.wander = 0.1;
  const support::TemporaryDirectory directory;
  const std::string file = directory.path("checks.csv");
  write_checks(file, support::make_line(factory, 1));
  const auto table = attribution::read_line_table({file});
  if (!table) return fmt::print("{}\n", table.error().message), 1;
  fmt::print(
      "{} checks, {} stations, {} batches, {} periods: standard "
      "deviations\n{:<10}{:>9}{:>9}{:>9}{:>9}{:>16}{:>9}\n",
      table->checks(), table->layout.stations, table->layout.batches, table->layout.periods, "", "brakes",
      "batches", "stations", "time", "station x time", "repeats");
  const auto start = std::chrono::steady_clock::now();
  attribution::CrossedEffects model(table->layout, table->parameters[0].values,
                                    table->parameters[0].deviations);
  model.fit();
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  const attribution::Deviations& ours = model.deviations();
  print_row("clampd", ours.brake, ours.batch, ours.station, ours.period, ours.wander, ours.repeat, seconds);
  const std::string command = fmt::format(
      "OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 Rscript '{}/tests/benchmarks/baselines/line.R' '{}' {}",
      CLAMPD_SOURCE_DIR, file, table->layout.periods);
  double brake = 0, batch = 0, station = 0, period = 0, wander = 0, repeat = 0, theirs = 0;
  std::FILE* answer = popen(command.c_str(), "r");
  const int read = answer == nullptr ? 0
                                     : std::fscanf(answer, "%lf %lf %lf %lf %lf %lf %lf", &brake, &batch,
                                                   &station, &period, &wander, &repeat, &theirs);
  if (answer != nullptr) pclose(answer);
  if (read != 7)
    return fmt::print("lme4 failed: is R there with lme4 (Debian: r-cran-lme4)? Going on without it.\n"), 0;
  print_row("lme4", brake, batch, station, period, wander, repeat, theirs);
  return 0;
}
