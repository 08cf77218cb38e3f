#pragma once

#include <gtest/gtest.h>

#include "drivers/sim/plant_configuration.hpp"
#include "tools/assembly/builtin.hpp"
#include "tools/assembly/embedded_station.hpp"
#include "tools/assembly/prepared_station.hpp"

namespace clampd::assembly {

inline PreparedStation prepared() {
  Result<PreparedStation> station = prepare_station(StationConfiguration{});
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

inline CheckRecord check(const sim::PlantConfiguration& brake, std::uint32_t repeats,
                         const EmbeddedStation::Progress& progress = nullptr) {
  EmbeddedStation station(prepared(), brake);
  Result<CheckRecord> record = station.run_check(request(repeats), nullptr, progress);
  EXPECT_TRUE(record);
  return *record;
}

}  // namespace clampd::assembly
