#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <utility>

#include "clampd/archive/store.hpp"
#include "clampd/base/result.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/record/run.hpp"
#include "clampd/simulation/plant.hpp"
#include "clampd/station/session.hpp"
#include "drivers/can/can_brake.hpp"
#include "drivers/can/embedded_bus.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "rt/control_core.hpp"

namespace clampd::bench {

/// A whole station with a simulated brake in one thread and in virtual time, for machines without CAN and for
/// tests: the same frames, tick, session and worker as on the bench; only the thread, the socket and the
/// metal are missing. The brake samples on every millisecond, the station's tick follows half a period later.
class EmbeddedStation {
 public:
  /// Both must be valid; neither is kept beyond what is copied here.
  EmbeddedStation(PreparedStation station, const sim::PlantConfiguration& plant);

  /// How far a check is; false asks for an operator stop.
  using Progress = std::function<bool(CheckPhase phase, std::uint32_t repeat, std::uint32_t repeats)>;

  /// Who hears of the search for a cause and may end it.
  void watch_search(CauseSearch search) { search_ = std::move(search); }

  /// How the last check's misfit was diagnosed, if it was.
  std::optional<Diagnosis> take_diagnosis() { return std::exchange(diagnosis_, std::nullopt); }

  /// One check to its record. Errors: the request is not valid.
  Result<CheckRecord> run_check(const CheckRequest& request, CheckStore* store, const Progress& progress);

  /// What the brake reads in so many samples with the drive off. Errors: the station is in FAULT.
  Result<Run> stand_by(std::size_t rows);

  /// Checks from now on replay this trajectory of the nominal brake, on the same brake, under the same limits
  /// and supervisor; their deadline grows with what they drive more. Errors: those of build_reference().
  Result<void> use_trajectory(const Run& trajectory);

 private:
  void advance_one_period();

  PreparedStation station_;
  const PreparedStation as_configured_;  ///< before use_trajectory()
  CauseSearch search_;
  std::optional<Diagnosis> diagnosis_;
  can::EmbeddedBus bus_;
  can::CanBrake port_;
  plant::Plant brake_;
  rt::ControlCore core_;
  std::int64_t now_ns_ = 0;
};

}  // namespace clampd::bench
