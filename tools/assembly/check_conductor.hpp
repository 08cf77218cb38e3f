#pragma once

#include <cstdint>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <string>

#include "clampd/archive/store.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/station/drive_off.hpp"
#include "clampd/station/session.hpp"
#include "rt/control_core.hpp"
#include "tools/assembly/prepared_station.hpp"

namespace clampd::assembly {

/// Both clocks, read at the edges: the wall clock for records, the steady one for deadlines.
struct Instant {
  std::int64_t steady_ns = 0;
  std::int64_t utc_ns = 0;
};

/// Takes checks through a control core: hands it the plan, empties its ring into the session, and turns the
/// end of the sequence into a saved record. Everything here runs outside of the real-time thread; one thread
/// at a time.
class CheckConductor {
 public:
  /// `core` must outlive this. Without a store, records are only returned.
  CheckConductor(const PreparedStation& station, rt::ControlCore& core, CheckStore* store, WorkerMode mode);
  /// The core must not run any more, or no check be under way.
  ~CheckConductor();

  /// What else is known of a fault, such as the line behind it: goes into the record's reason. Empty:
  /// nothing.
  void explain_faults_by(std::function<std::string(FaultCause)> explain) { explain_ = std::move(explain); }

  /// Who else sees every sample of a check, in the order of the ring, from within pump().
  void show_samples_to(std::function<void(const Sample&)> watcher) { watcher_ = std::move(watcher); }

  /// Starts a check. Errors: the request is not valid, the station is not IDLE (with its fault), a check is
  /// under way.
  Result<void> begin(const CheckRequest& request, Instant now);

  /// Empties the ring; gives the record once the check has ended and its runs are identified, and diagnosed
  /// if need be: in the background mode beside the calls, which then never wait. Call it at least every
  /// second: the ring holds eight. A record that could not be saved comes as an ERROR that says so, and again
  /// with its own verdict once it is saved, which is tried every second; no check begins in between.
  std::optional<CheckRecord> pump(Instant now);

  bool busy() const { return session_ != nullptr; }
  /// The brake is done, the record not yet.
  bool concluding() const { return conclusion_.valid(); }
  /// Why the last result is not on record yet; empty: it is.
  const std::string& storage_problem() const { return storage_problem_; }
  /// The result that is not on record yet, with its own verdict.
  const std::optional<CheckRecord>& unsaved() const { return unsaved_; }
  CheckSession::Progress progress() const;
  const std::string& serial() const { return serial_; }

 private:
  CheckOutcome outcome_at(Instant now);
  std::optional<CheckRecord> keep(CheckRecord record, Instant now);
  Result<void> save(const CheckRecord& record);

  const PreparedStation& station_;
  rt::ControlCore& core_;
  DriveOffReadings off_;
  CheckStore* store_;
  WorkerMode mode_;
  std::function<std::string(FaultCause)> explain_;
  std::function<void(const Sample&)> watcher_;
  rt::CheckPlan plan_;
  std::unique_ptr<CheckSession> session_;
  std::string serial_;
  std::uint64_t finished_before_ = 0;
  PortHealth health_before_;
  std::int64_t started_steady_ns_ = 0;
  bool deadline_passed_ = false;
  std::optional<CheckRecord> unsaved_;  ///< judged, but not on record yet
  std::int64_t save_again_ns_ = 0;      ///< steady
  std::string storage_problem_;
  std::future<CheckRecord> conclusion_;  ///< last: what makes it uses the session
};

}  // namespace clampd::assembly
