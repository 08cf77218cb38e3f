#pragma once

#include <cstdint>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "clampd/archive/store.hpp"
#include "clampd/bench/check_journal.hpp"
#include "clampd/bench/disk_thread.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/station/drive_off.hpp"
#include "clampd/station/session.hpp"
#include "rt/control_core.hpp"

namespace clampd::bench {

/// Both clocks, read at the edges: the wall clock for records, the steady one for deadlines.
struct Instant {
  std::int64_t steady_ns = 0;
  std::int64_t utc_ns = 0;
};

/// The last opening of a brake that stayed clamped.
struct Opening {
  std::string id;  ///< unique; empty: there was none
  bool under_way = false;
  Verdict verdict = Verdict::Error;  ///< once it ended: PASS means open
  std::string reason;
};

/// Takes checks through a control core: hands it the plan, empties its ring into the session, and turns the
/// end of the sequence into a saved record. Everything here runs outside of the real-time thread; one thread
/// at a time.
class CheckConductor {
 public:
  /// `core` and `store` must outlive this. Without a store, records are only returned. In the background mode
  /// the store belongs to disk() alone.
  CheckConductor(const PreparedStation& station, rt::ControlCore& core, CheckStore* store, WorkerMode mode);
  /// The core must not run any more, or no check be under way.
  ~CheckConductor();

  /// What else is known of a fault, such as the line behind it: goes into the record's reason. Empty:
  /// nothing.
  void explain_faults_by(std::function<std::string(FaultCause)> explain) { explain_ = std::move(explain); }

  /// Who else sees every sample of a check, in the order of the ring, from within pump().
  void show_samples_to(std::function<void(const Sample&)> watcher) { watcher_ = std::move(watcher); }

  /// Checks are journalled in this file while they are under way.
  void journal_in(std::string file) { journal_.emplace(std::move(file)); }

  /// What is done to a record once it is saved and before it is shown, beside the store.
  void finish_records_by(std::function<void(CheckRecord&)> finish) { finish_ = std::move(finish); }

  /// Who hears of the search for a cause and may end it, in this and the next checks.
  void watch_search(CauseSearch search) { search_ = std::move(search); }

  /// Starts a check that was asked for with this ticket, by the recipe that is chosen now. Errors: the request is
  /// not valid or chooses no recipe (choose_check()), the station is not
  /// IDLE (with its fault), a check is under way, the ticket is void. Should it become void just then, the
  /// check ends as one that never moved.
  Result<void> begin(const CheckRequest& request, const rt::StartTicket& ticket, Instant now);
  /// The same, asked for now.
  Result<void> begin(const CheckRequest& request, Instant now) { return begin(request, core_.ticket(), now); }

  /// Opens a brake that may be clamped, supervised as a check is. Errors as begin(); nothing is recorded.
  Result<void> open(const rt::StartTicket& ticket, Instant now);

  /// Empties the ring; gives the record once the check has ended and its runs are identified, and diagnosed
  /// if need be, and it is saved: in the background mode beside the calls, which then never wait. Call it at
  /// least every second: the ring holds eight. A record that could not be saved comes as an ERROR that says
  /// so, and again with its own verdict once it is saved, which is tried every second; no check begins in
  /// between.
  std::optional<CheckRecord> pump(Instant now);

  /// Between the begin of a check or an opening and its end.
  bool busy() const { return session_ != nullptr || opening_.under_way; }
  /// The brake is done, the record not yet.
  bool concluding() const { return session_ != nullptr && (conclusion_.valid() || saving_.valid()); }
  /// Why the last result is not on record yet; empty: it is.
  const std::string& storage_problem() const { return storage_problem_; }
  /// The result that is not on record yet, with its own verdict; null: there is none.
  const CheckRecord* unsaved() const { return unsaved_.get(); }
  /// It is being tried right now.
  bool saving() const { return saving_.valid(); }
  CheckSession::Progress progress() const;
  const std::string& serial() const { return serial_; }
  /// Of the check under way or the last one, as its record has it; empty: there was none.
  const std::string& id() const { return id_; }
  const Opening& opening() const { return opening_; }
  /// What the runs of the check under way or the last one are to follow; before the first, the station's own.
  const rt::CheckPlan& plan() const { return plan_; }
  /// Of that check.
  const std::string& part_number() const { return part_number_; }

  /// Whoever else needs the store that the background mode saves to.
  DiskThread& disk() { return disk_; }
  /// How the last check's misfit was diagnosed, if it was.
  std::optional<Diagnosis> take_diagnosis() { return std::exchange(diagnosis_, std::nullopt); }

 private:
  Result<void> may_start(const rt::StartTicket& ticket) const;
  void hand_over(const rt::StartTicket& ticket);
  void advise_loop();
  void take_samples();
  CheckOutcome outcome_at(Instant now);
  void explain_fault(CheckOutcome& outcome, const rt::CheckEnd& end) const;
  void end_opening(const CheckOutcome& outcome);
  std::optional<CheckRecord> keep(CheckRecord record, Instant now);
  void save_beside(Instant now);
  std::optional<CheckRecord> after_saving(const Result<void>& saved, Instant now);
  Result<void> save(CheckRecord& record) const;

  const PreparedStation& station_;
  rt::ControlCore& core_;
  DriveOffReadings off_;
  CheckStore* store_;
  WorkerMode mode_;
  std::function<std::string(FaultCause)> explain_;
  std::function<void(const Sample&)> watcher_;
  std::function<void(CheckRecord&)> finish_;
  std::optional<CheckJournal> journal_;
  rt::CheckPlan plan_;
  std::unique_ptr<CheckSession> session_;
  const PreparedCheck* check_;  ///< of the check under way or the last one, within station_
  std::string serial_;
  std::string part_number_;
  std::string id_;
  Opening opening_;
  CauseSearch search_;
  std::optional<Diagnosis> diagnosis_;
  std::uint64_t finished_before_ = 0;
  PortHealth health_before_;
  std::shared_ptr<CheckRecord> unsaved_;  ///< judged, but not on record yet
  bool shown_unsaved_ = false;            ///< as an ERROR
  std::int64_t saving_since_ns_ = 0;      ///< steady, as the next one
  std::int64_t save_again_ns_ = 0;
  std::string storage_problem_;
  std::future<Result<void>> saving_;
  DiskThread disk_;
  std::future<CheckRecord> conclusion_;  ///< last: what makes it uses the session
};

}  // namespace clampd::bench
