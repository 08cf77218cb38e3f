#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <future>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "clampd/api/control_server.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/base/result.hpp"
#include "clampd/bench/check_conductor.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/bench/publishing.hpp"
#include "clampd/bench/simulated_bench.hpp"
#include "clampd/daemon/clock_watch.hpp"
#include "clampd/daemon/live_feed.hpp"
#include "clampd/line/master.hpp"
#include "drivers/can/bus.hpp"
#include "drivers/can/can_brake.hpp"
#include "drivers/can/socketcan.hpp"
#include "drivers/gpio/panel.hpp"
#include "rt/control_core.hpp"
#include "rt/cyclic_thread.hpp"

namespace clampd::daemon {

/// The station at work: the real-time loop on SocketCAN or a simulated bench, the conductor that empties its
/// ring, and what the control API asks for. Everything here runs outside of the real-time thread.
class Daemon final : public api::ControlTarget {
 public:
  /// `station`, `bus`, `store` and `panel` must outlive this. Without a panel the station has no interlocks.
  Daemon(const bench::PreparedStation& station, can::SocketCanBus& bus, CheckStore& store,
         gpio::Panel* panel);
  /// The same without CAN, on a simulated brake, which must outlive this too.
  Daemon(const bench::PreparedStation& station, bench::SimulatedBench& bench, CheckStore& store);

  /// Starts the loop thread. Errors: no right to real time, with what to change.
  Result<void> start();

  /// Serves until `quit` is set: records finished checks, reopens a vanished interface. A check under way is
  /// then stopped, and its record saved, before this returns. `each_round` is called every few milliseconds.
  void serve(const std::atomic<bool>& quit, const std::function<void()>& each_round);

  /// Ticks that the loop has made.
  std::uint64_t ticks() const { return core_.status().ticks.load(); }
  /// The station in one line.
  std::string headline() const;

  api::StationStatus status() override;
  std::string metrics() override;
  rt::StartTicket ticket() const override;
  Result<api::StartedCheck> start(const CheckRequest& request, const rt::StartTicket& ticket,
                                      std::optional<std::uint64_t> stops_seen) override;
  Result<std::string> open(const rt::StartTicket& ticket, std::optional<std::uint64_t> stops_seen) override;
  Result<void> next(const CheckRequest& request) override;
  api::CheckProgress progress(bool colour) override;
  Result<void> stop() override;
  Result<void> clear() override;
  Result<nlohmann::ordered_json> results(const CheckFilter& filter) override;
  Result<nlohmann::ordered_json> result(const std::string& id) override;
  Result<nlohmann::ordered_json> run(const std::string& id, std::size_t number) override;
  Result<nlohmann::ordered_json> statistics(const CheckFilter& filter) override;
  nlohmann::ordered_json reference() override;
  nlohmann::ordered_json live(std::uint64_t run, std::size_t row) override;

 private:
  Daemon(const bench::PreparedStation& station, can::FrameBus& bus, CheckStore& store, gpio::Panel* panel,
         can::SocketCanBus* socket, bench::SimulatedBench* bench);
  /// What the disk is asked now and then, in its thread.
  struct Upkeep {
    std::optional<MasterReport> master;  ///< nothing: not looked at
    std::vector<bench::ChannelReport> publishing;
  };

  void pump();
  void keep(CheckRecord record);
  void report_state_changes();
  void watch_clamping();
  void serve_panel();
  void look_after_records();
  Upkeep upkeep(bool thorough, std::int64_t now_utc_ns);
  MasterReport master_now(std::int64_t now_utc_ns);
  void judge_master(CheckRecord& record);
  Result<CheckStore> archive() const;
  Result<void> may_move() const;
  Result<api::StartedCheck> begin_pressed(const gpio::StartPress::Press& press);
  Result<api::StartedCheck> begin(const CheckRequest& request, const rt::StartTicket& ticket);
  std::string fault_text(FaultCause fault) const;
  void reopen_bus_if_gone();

  const bench::PreparedStation& station_;
  CheckStore& store_;  ///< for the conductor's disk thread alone
  gpio::Panel* panel_;
  can::SocketCanBus* socket_;  ///< null: on a simulated bench
  can::CanBrake port_;
  rt::ControlCore core_;
  rt::FinerGrid<rt::ControlCore> finer_grid_;
  std::optional<bench::SimulatedBench::Loop> simulated_loop_;
  rt::CyclicThread loop_;

  LiveFeed live_;

  bench::CheckJournal journal_;
  std::mutex mutex_;  ///< guards all below; nobody who has it waits for the disk
  bool serving_ = false;
  std::uint64_t check_number_ = 0;
  std::optional<CheckRecord> last_record_;
  std::array<std::uint64_t, kVerdicts.size()> verdicts_{};  ///< since the daemon started
  std::optional<CheckRequest> next_;  ///< what the start button checks
  ClockWatch clock_watch_;
  std::string clock_;                ///< that it was set since the last check began
  std::string notice_;               ///< why the start button did nothing
  std::int64_t records_due_ns_ = 0;  ///< when to look after the records again, monotonic
  std::int64_t outboxes_due_ns_ = 0;
  std::optional<std::string> master_;  ///< what the master brake asks for; nothing: not known yet
  std::vector<bench::ChannelReport> channels_;
  StationState reported_state_ = StationState::Init;
  std::uint64_t reported_stops_ = 0;
  std::string reported_opening_;
  double force_zero_N_ = 0.0;  ///< as the last tare found it
  bool clamped_ = false;
  std::optional<bench::Publishing> publishing_;
  std::future<Upkeep> upkeep_;
  std::future<Result<std::optional<CheckRecord>>> recovery_;
  bench::CheckConductor conductor_;  ///< last: its disk thread uses what is above
};

}  // namespace clampd::daemon
