#pragma once

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "clampd/attribution/line_table.hpp"

namespace clampd::support {

/// A line of which everything is known: what its tests hide, and how its brakes come to its stations.
struct Factory {
  int stations = 20;
  int batches = 60;
  int brakes = 6000;
  double checked_twice = 0.1;  ///< share of the brakes, the second time at a station of chance
  bool batch_at_one_station = false;
  double mean = 50.0;
  attribution::Deviations deviations{.repeat = 0.2,
                                     .brake = 1.0,
                                     .batch = 0.5,
                                     .station = 0.4,
                                     .fixture = 0.0,
                                     .period = 0.1,
                                     .wander = 0.0};
  double identification =
      0.3;  ///< the largest standard deviation that it reports; the smallest is half of it
  int step_station = -1;
  double step_at = 0.5;  ///< share of the time
  double step = 0.0;
  int drift_station = -1;
  double drift = 0.0;
  int apart_batch = -1;
  double apart = 0.0;
};

/// Checks of one parameter, in chronological order. Batches follow each other, two or three at a time.
inline attribution::LineTable make_line(const Factory& factory, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const auto draw = [&](int count, double deviation) {
    std::vector<double> effects;
    for (int i = 0; i < count; ++i) effects.push_back(deviation * normal(random));
    return effects;
  };
  attribution::LineTable table;
  attribution::Layout& layout = table.layout;
  layout.stations = factory.stations;
  layout.fixtures = factory.stations;
  layout.batches = factory.batches;
  layout.brakes = factory.brakes;
  const std::size_t about = static_cast<std::size_t>(factory.brakes * (1.0 + factory.checked_twice));
  layout.periods = attribution::periods_of(about, factory.stations);
  for (int s = 0; s < factory.stations; ++s) {
    table.stations.push_back("station " + std::to_string(s));
    table.fixtures.push_back(table.stations.back() + " / -");
  }
  for (int b = 0; b < factory.batches; ++b) table.batches.push_back("batch " + std::to_string(b));
  table.last_s = 1e7;
  table.parameters.push_back({"k2", "N/rad^2", {}, {}});
  const std::vector<double> batch = draw(factory.batches, factory.deviations.batch);
  const std::vector<double> station = draw(factory.stations, factory.deviations.station);
  const std::vector<double> period = draw(layout.periods, factory.deviations.period);
  const std::vector<double> wander = draw(layout.periods * factory.stations, factory.deviations.wander);
  for (int brake = 0; brake < factory.brakes; ++brake) {
    const double time = (brake + uniform(random)) / factory.brakes;
    const double of_batches = time * factory.batches + 1.5 * (uniform(random) - 0.5);
    const int b = std::clamp(static_cast<int>(of_batches), 0, factory.batches - 1);
    const double of_brake = factory.deviations.brake * normal(random);
    const int times = uniform(random) < factory.checked_twice ? 2 : 1;
    for (int check = 0; check < times; ++check) {
      const int any = std::min(factory.stations - 1, static_cast<int>(uniform(random) * factory.stations));
      const int s = factory.batch_at_one_station && check == 0 ? b % factory.stations : any;
      const int p = std::min(layout.periods - 1, static_cast<int>(time * layout.periods));
      const double sd = factory.identification * (0.5 + 0.5 * uniform(random));
      double value = factory.mean + of_brake + batch[static_cast<std::size_t>(b)] +
                     station[static_cast<std::size_t>(s)] + period[static_cast<std::size_t>(p)] +
                     wander[static_cast<std::size_t>(p * factory.stations + s)] +
                     factory.deviations.repeat * normal(random) + sd * normal(random);
      if (s == factory.step_station && time >= factory.step_at) value += factory.step;
      if (s == factory.drift_station) value += factory.drift * time;
      if (b == factory.apart_batch) value += factory.apart;
      layout.brake.push_back(brake);
      layout.batch.push_back(b);
      layout.station.push_back(s);
      layout.fixture.push_back(s);
      layout.period.push_back(p);
      table.parameters[0].values.push_back(value);
      table.parameters[0].deviations.push_back(sd);
    }
  }
  table.rows = layout.brake.size();
  return table;
}

}  // namespace clampd::support
