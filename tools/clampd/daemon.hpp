#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <optional>
#include <string>

#include "clampd/archive/store.hpp"
#include "clampd/base/result.hpp"
#include "drivers/can/bus.hpp"
#include "drivers/can/can_brake.hpp"
#include "drivers/can/socketcan.hpp"
#include "drivers/gpio/panel.hpp"
#include "rt/control_core.hpp"
#include "rt/cyclic_thread.hpp"
#include "tools/assembly/check_conductor.hpp"
#include "tools/assembly/prepared_station.hpp"
#include "tools/assembly/publishing.hpp"
#include "tools/assembly/simulated_bench.hpp"
#include "tools/clampd/clock_watch.hpp"
#include "tools/clampd/control_server.hpp"
#include "tools/clampd/live_feed.hpp"

namespace clampd::daemon {

/// The station at work: the real-time loop on SocketCAN or a simulated bench, the conductor that empties its
/// ring, and what the control API asks for. Everything here runs outside of the real-time thread.
class Daemon final : public ControlTarget {
 public:
  /// `station`, `bus`, `store` and `panel` must outlive this. Without a panel the station has no interlocks.
  Daemon(const assembly::PreparedStation& station, can::SocketCanBus& bus, CheckStore& store,
         gpio::Panel* panel);
  /// The same without CAN, on a simulated brake, which must outlive this too.
  Daemon(const assembly::PreparedStation& station, assembly::SimulatedBench& bench, CheckStore& store);

  /// Starts the loop thread. Errors: no right to real time, with what to change.
  Result<void> start();

  /// Serves until `quit` is set: records finished checks, reopens a vanished interface. A check under way is
  /// then stopped, and its record saved, before this returns. `each_round` is called every few milliseconds.
  void serve(const std::atomic<bool>& quit, const std::function<void()>& each_round);

  /// Ticks that the loop has made.
  std::uint64_t ticks() const { return core_.status().ticks.load(); }
  /// The station in one line.
  std::string headline() const;

  control::StationStatus status() override;
  Result<std::uint64_t> start(const CheckRequest& request) override;
  Result<void> next(const CheckRequest& request) override;
  control::CheckProgress progress(bool colour) override;
  Result<void> stop() override;
  Result<void> clear() override;
  Result<nlohmann::ordered_json> results(const CheckFilter& filter) override;
  Result<nlohmann::ordered_json> result(const std::string& id) override;
  Result<nlohmann::ordered_json> run(const std::string& id, std::size_t number) override;
  Result<nlohmann::ordered_json> statistics(std::uint32_t limit) override;
  nlohmann::ordered_json reference() override;
  nlohmann::ordered_json live(std::uint64_t run, std::size_t row) override;

 private:
  Daemon(const assembly::PreparedStation& station, can::FrameBus& bus, CheckStore& store, gpio::Panel* panel,
         can::SocketCanBus* socket, assembly::SimulatedBench* bench);
  void pump();
  void report_state_changes();
  void serve_panel();
  void look_after_records();
  Result<std::uint64_t> begin(const CheckRequest& request);
  std::string fault_text(FaultCause fault) const;
  void reopen_bus_if_gone();

  const assembly::PreparedStation& station_;
  CheckStore& store_;
  gpio::Panel* panel_;
  can::SocketCanBus* socket_;  ///< null: on a simulated bench
  can::CanBrake port_;
  rt::ControlCore core_;
  std::optional<assembly::SimulatedBench::Loop> simulated_loop_;
  rt::CyclicThread loop_;

  LiveFeed live_;

  std::mutex mutex_;  ///< guards all below, and store_
  assembly::CheckConductor conductor_;
  std::uint64_t check_number_ = 0;
  std::optional<CheckRecord> last_record_;
  std::optional<CheckRequest> next_;  ///< what the start button checks
  ClockWatch clock_watch_;
  std::string clock_;                ///< that it was set since the last check began
  std::string notice_;               ///< why the start button did nothing
  std::int64_t records_due_ns_ = 0;  ///< when to look after the records again, monotonic
  std::string master_;               ///< what the master brake asks for; empty: nothing
  StationState reported_state_ = StationState::Init;
  std::optional<assembly::Publishing> publishing_;
};

}  // namespace clampd::daemon
