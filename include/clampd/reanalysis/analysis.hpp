#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/reanalysis/task.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/station/run_collector.hpp"

namespace clampd::reanalysis {

/// A run as the archive holds it.
struct ArchivedRun {
  std::string name;
  std::string sha256;               ///< of the run's file, as the check recorded it
  std::optional<std::string> data;  ///< that file, compressed; nothing: it is not there (any more)
  double tracking_rms_N = 0.0;
  double tracking_max_N = 0.0;
  std::uint8_t trajectory = 0;  ///< of the check's, which it followed
};

/// A check as the archive holds it, as far as its verdict depends on it.
struct ArchivedCheck {
  std::string id;
  std::string serial;
  Verdict verdict = Verdict::Error;  ///< as it was recorded
  std::string reason;
  std::string fault;  ///< name of its cause; "none": there was none
  std::uint32_t repeats = 0;
  /// Nothing: their number was fixed, or is not known to have been.
  std::optional<StoppingRecord> stopping;
  bool chose_runs = false;        ///< by what was in doubt; then guard bands are wider
  bool is_stopping_known = true;  ///< false: published by a version that did not say it
  /// What it was asked, not what came of it; without lines where there was no estimate. Nothing: no sheet.
  std::optional<SheetRecord> sheet;
  std::uint64_t ticks_skipped = 0;
  std::uint64_t samples_lost = 0;
  double tracking_rms_N = 0.0;
  /// Deviations of the tare's means; nothing: the sensors were not tared.
  std::optional<double> tare_force_sd_N;
  std::optional<double> tare_velocity_sd_rad_s;
  std::optional<double> found_rad;  ///< as the record has it
  std::vector<ArchivedRun> runs;
};

/// The archive's runs as a station collected them. Errors: a run is missing, does not have its checksum, or
/// is no run file.
Result<std::vector<CollectedRun>> unpack_runs(const ArchivedCheck& check);

/// Does with the runs what the task says, on one thread. Identify: as a station does (each run, then all jointly), and judges by the
/// task's limits, with the guard bands of the record's stopping rule and the task's or the record's sheet, which is left out beside a
/// model (clampd.reanalysis/2). Diagnose: as `clampctl diagnose` (clampd.archived_diagnosis/1). ScoreEffects: score_effects()
/// (clampd.effect_scores/2). The document (JSON) says nothing of the time it took or was made at, so that equal runs, task and
/// software give equal texts. Nothing if `given_up` said so meanwhile. Errors: runs that cannot be diagnosed or scored;
/// a stopping rule that no station has; a record's sheet of which this version does not know a line, or that has none on record.
Result<std::optional<std::string>> analyse(const ArchivedCheck& check, std::vector<CollectedRun> runs,
                                           const Task& task, const std::string& task_sha256,
                                           const std::function<bool()>& given_up);

}  // namespace clampd::reanalysis
