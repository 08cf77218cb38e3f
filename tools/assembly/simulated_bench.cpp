#include "tools/assembly/simulated_bench.hpp"

namespace clampd::assembly {

SimulatedBench::SimulatedBench(const PreparedStation& station, const sim::PlantConfiguration& plant)
    : bus_(static_cast<double>(station.configuration.can.bitrate)),
      brake_(bus_.end(can::EmbeddedBus::End::Brake), station.codec, plant, nullptr) {}

}  // namespace clampd::assembly
