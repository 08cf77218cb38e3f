#pragma once

#include <gtest/gtest.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "clampd/bench/builtin.hpp"
#include "clampd/bench/check_conductor.hpp"
#include "clampd/bench/embedded_station.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "drivers/can/can_brake.hpp"
#include "drivers/can/embedded_bus.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "tests/support/told.hpp"

namespace clampd::bench {

/// Of the shipped brake, or of the same one that is told otherwise.
inline PreparedStation prepared(const Told& told = {}) {
  StationConfiguration configuration;
  configuration.can.feedback_cycle_ms = configuration.can.command_cycle_ms = 1e3 * told.period_s;
  configuration.check.method = told.method;
  if (told.commanded == CommandedQuantity::Velocity) {
    configuration.can.dbc = CLAMPD_SOURCE_DIR "/tests/support/speed_brake.dbc";
    configuration.can.mapping = {{"torque_command", ""},
                                 {"velocity_command", "BrakeCommand.VelocityCommand"}};
  }
  Result<PreparedStation> station = prepare_station(configuration);
  EXPECT_TRUE(station) << station.error().message;
  return std::move(*station);
}

inline sim::PlantConfiguration plant(std::uint64_t seed) {
  Result<sim::PlantConfiguration> read = sim::parse_plant_configuration(kBuiltinPlant, "plant.toml");
  EXPECT_TRUE(read) << read.error().message;
  read->seed = seed;
  return *read;
}

inline CheckRequest request(std::uint32_t repeats) {
  CheckRequest asked;
  asked.serial = "TEST-1";
  asked.repeats = repeats;
  return asked;
}

/// Error: the station refuses to begin.
inline Result<CheckRecord> try_check(const sim::PlantConfiguration& brake, std::uint32_t repeats,
                                     const EmbeddedStation::Progress& progress = nullptr,
                                     const Told& told = {}) {
  EmbeddedStation station(prepared(told), brake);
  return station.run_check(request(repeats), nullptr, progress);
}

inline CheckRecord check(const sim::PlantConfiguration& brake, std::uint32_t repeats,
                         const EmbeddedStation::Progress& progress = nullptr, const Told& told = {}) {
  Result<CheckRecord> record = try_check(brake, repeats, progress, told);
  if (!record) throw std::runtime_error("no record of the check: " + record.error().message);
  return *record;
}

/// A conductor with all it conducts.
struct Bench {
  Bench(const sim::PlantConfiguration& configured, WorkerMode mode, CheckStore* store = nullptr,
        PreparedStation prepared_station = prepared())
      : station(std::move(prepared_station)),
        brake(bus.end(can::EmbeddedBus::End::Brake), station.codec, configured, nullptr),
        conductor(station, core, store, mode) {}

  void advance() {
    brake.tick(now_ns, 0, 0);
    core.tick(now_ns + station.codec.period_ns / 2, 0, 0);
    now_ns += station.codec.period_ns;
  }
  void reach(StationState state) {
    while (core.status().state.load() != state) advance();
  }
  std::optional<CheckRecord> pump() { return conductor.pump({now_ns, now_ns}); }
  Result<void> begin(std::uint32_t repeats) { return conductor.begin(request(repeats), {now_ns, now_ns}); }
  /// Until there is a record.
  CheckRecord finish() {
    while (true) {
      advance();
      if (std::optional<CheckRecord> record = pump()) return *std::move(record);
    }
  }

  const PreparedStation station;
  can::EmbeddedBus bus{static_cast<double>(station.configuration.can.bitrate)};
  can::CanBrake port{bus.end(can::EmbeddedBus::End::Station), station.codec};
  plant::Plant brake;
  rt::ControlCore core{port, station.supervisor};
  CheckConductor conductor;
  std::int64_t now_ns = 0;
};

}  // namespace clampd::bench
