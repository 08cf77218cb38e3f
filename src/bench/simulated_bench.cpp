#include "clampd/bench/simulated_bench.hpp"

namespace clampd::bench {

SimulatedBench::SimulatedBench(const PreparedStation& station, const sim::PlantConfiguration& plant)
    : codec_(station.codec),
      bus_(static_cast<double>(station.configuration.can.bitrate),
           bus_format(station.configuration, station.codec)),
      brake_(bus_.end(can::EmbeddedBus::End::Brake), station.codec, plant, nullptr) {}

}  // namespace clampd::bench
