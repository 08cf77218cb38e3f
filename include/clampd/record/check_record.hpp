#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "clampd/record/run.hpp"
#include "clampd/record/sample.hpp"

namespace clampd {

enum class Verdict : std::uint8_t { Pass, Fail, Error, Timeout, Aborted };
inline constexpr std::array kVerdicts{Verdict::Pass, Verdict::Fail, Verdict::Error, Verdict::Timeout,
                                      Verdict::Aborted};  ///< all of them, in their order
std::string_view to_string(Verdict verdict) noexcept;     ///< "PASS", "FAIL", "ERROR", "TIMEOUT", "ABORTED"
std::optional<Verdict> parse_verdict(
    std::string_view text) noexcept;  ///< the same back; nothing if it is none of them

/// Whether it says something about the brake, and not about the station or the check.
constexpr bool is_about_the_brake(Verdict verdict) noexcept {
  return verdict == Verdict::Pass || verdict == Verdict::Fail;
}

enum class ParameterVerdict : std::uint8_t { Pass, Marginal, Fail };
std::string_view to_string(ParameterVerdict verdict) noexcept;  ///< "pass", "marginal", "fail"

/// One identified parameter against its limits, all in `unit`.
struct ParameterRecord {
  std::string name;
  std::string unit;
  double value = 0.0;
  double sd = 0.0;
  double lower = 0.0;
  double upper = 0.0;
  ParameterVerdict verdict = ParameterVerdict::Fail;
};

/// One line of the sheet: a characteristic of the brake against its limits, all in `unit`.
struct CharacteristicRecord {
  std::string name;
  std::string kind;
  std::string unit;
  double value = 0.0;  ///< NaN: it is not known, or not reached
  double sd = 0.0;     ///< the 95 % interval is the value ± 1.96 of them
  double lower = 0.0;  ///< -infinity: no lower limit
  double upper = 0.0;  ///< infinity: no upper limit
  /// Nothing: there are no limits, or it is not known.
  std::optional<ParameterVerdict> verdict = {};
  std::string why = {};            ///< there is no value; empty where there is one
  std::string circumstances = {};  ///< that it is asked for in: "force_N 20000, share 0.9"

  bool has_limits() const;
  bool is_known() const;
};

/// The two ends of the 95 % interval; NaN where it is not known.
std::pair<double, double> interval_95(const CharacteristicRecord& line);

/// What a requirement sheet asks of a brake, and what the check says of it.
struct SheetRecord {
  std::string file;
  std::string revision;
  std::string sha256;
  bool misfit_marked = false;  ///< the model does not explain all of this brake's motion: deviations count it
  std::vector<CharacteristicRecord> characteristics;  ///< empty where there is no estimate
};

/// Wake-up lateness of the loop, in cyclictest's words, and what it missed.
struct TimingRecord {
  std::uint64_t ticks = 0;
  std::uint64_t skipped = 0;
  std::uint64_t lost_samples = 0;
  double lateness_min_us = 0.0;
  double lateness_avg_us = 0.0;
  double lateness_max_us = 0.0;
  std::vector<std::uint64_t>
      lateness_histogram;  ///< ticks per microsecond of lateness; the last bin takes the rest
  double bus_load = 0.0;   ///< measured share of the bus's bits, 0..1; 0 where there is no wire
};

/// One repeat of the trajectory: the data, and how well they were tracked and fitted.
struct RunRecord {
  Run run;
  std::uint8_t trajectory = 0;  ///< that it follows, of StoppingRecord::trajectories; 0 where there is none
  double tracking_rms_N = 0.0;  ///< measured force minus reference
  double tracking_max_N = 0.0;
  double fit_force_rms_N = 0.0;
  double fit_velocity_rms_rad_s = 0.0;
  std::vector<double> estimate;  ///< the seven parameters from this run alone, SI, in the table's order
  bool converged = false;
  std::string checksum_sha256;  ///< of format_run(run)
  std::string removed;  ///< RFC 3339: when retention removed the rows of `run`; empty while they are there
};

/// Why the brake model does not explain a check's runs, as their diagnosis has it.
struct CauseRecord {
  std::string verdict;               ///< of the diagnosis: "explained", "ambiguous" or "unexplained"
  std::vector<std::string> effects;  ///< named ones, the strongest first; empty if nothing known explains it
  std::string location;              ///< of the first, or else of the misfit; empty if it cannot be told
  std::vector<std::vector<std::string>> rivals;  ///< each group: effects that the runs cannot tell apart
  std::string summary;                           ///< one sentence a technician understands

  bool operator==(const CauseRecord&) const = default;
};

/// What the runs of a check show that the model lacks (systematic_misfit).
struct SystematicRecord {
  double p_value = 1.0;     ///< chance that noise alone shows as much
  double over_noise = 0.0;  ///< rms of what repeats have in common over that of one repeat's noise
  double moved_sd = 0.0;    ///< the most that it may move a parameter, over its sd by the noise alone
  bool marked = false;      ///< significant, and it may move a parameter by more than that sd: sd count it

  bool operator==(const SystematicRecord&) const = default;
};

/// Why a check of as many repeats as its brake needs took this many.
struct StoppingRecord {
  std::uint32_t most = 0;  ///< repeats that were allowed
  double coverage_factor =
      0.0;  ///< half width of the guard band in standard deviations that are known, whenever it ends
  std::string reason;  ///< "every limit decided after 4 runs", "the most that was allowed: 21; TC in doubt"
  /// SHA-256 of each trajectory that a run could follow; the first is CheckRecord::trajectory_sha256. Empty: there
  /// was no choice.
  std::vector<std::string> trajectories = {};
  std::vector<std::uint8_t> followed = {};  ///< by each run: which of them; empty like them

  bool operator==(const StoppingRecord&) const = default;
};

/// Which recipe a brake was checked by; its part number is the record's.
struct RecipeRecord {
  std::string file;
  std::string version;
  std::string sha256;  ///< of the file's text

  bool operator==(const RecipeRecord&) const = default;
};

/// Why a record does not count any more.
struct VoidRecord {
  std::string reason;
  std::string by;    ///< as the operating system calls whoever said so
  std::string when;  ///< RFC 3339, UTC

  bool operator==(const VoidRecord&) const = default;
};

/// Everything the trade expects in the record of one check (traceability first).
struct CheckRecord {
  std::string id;  ///< unique, sortable by time
  std::string serial;
  std::string part_number;
  std::optional<RecipeRecord> recipe;  ///< nothing where the station has no recipes
  std::string batch;
  std::string station;
  std::string fixture;
  std::string operator_name;
  std::string software_version;
  std::string limits_file;
  std::string limits_revision;
  std::string limits_sha256;
  std::string trajectory_sha256;
  std::string instruments;    ///< JSON array as configured: name, serial, calibration date
  bool simulated = false;     ///< the brake was a simulated one: such a result says nothing about hardware
  std::string started;        ///< RFC 3339, UTC
  std::string stopped;        ///< RFC 3339, UTC
  double duration_s = 0.0;    ///< bench time
  std::uint32_t repeats = 0;  ///< that its verdict rests on, or that were planned
  std::optional<StoppingRecord> stopping;  ///< nothing where their number was fixed

  Verdict verdict = Verdict::Error;
  bool marginal = false;
  std::string reason;  ///< one sentence a technician understands
  FaultCause fault = FaultCause::None;
  std::optional<CauseRecord> cause;  ///< of an ERROR or FAIL whose runs the model does not explain

  std::optional<SystematicRecord> systematic;  ///< nothing where it cannot be told, as from a few repeats

  std::optional<VoidRecord> voided;  ///< said later: it stays on record, but counts in no statistics

  std::vector<ParameterRecord> parameters;    ///< the seven, then "EFFECT.PARAMETER" of an extended model
  std::optional<SheetRecord> sheet;           ///< nothing where the station has none
  std::vector<double> covariance_normalised;  ///< 7 x 7, row-major; empty where there is no fit
  std::string method;                         ///< of identification: oem or pem
  double noise_force_N = 0.0;
  double noise_velocity_rad_s = 0.0;
  double noise_torque_Nm = 0.0;
  /// The zeros that the tare took off the readings, and how sure they are; 0: not tared.
  double tare_force_N = 0.0;
  double tare_force_sd_N = 0.0;
  double tare_velocity_rad_s = 0.0;
  double tare_velocity_sd_rad_s = 0.0;
  std::optional<TorqueWhileOff> torque_while_off;  ///< just before the check
  /// The motor encoder's reading in the first sample, before the station moved anything; nothing: no sample
  /// came, or it was recorded by a version that did not keep it.
  std::optional<double> found_rad;
  double tracking_rms_N = 0.0;                     ///< over all repeats
  TimingRecord timing;
  std::vector<RunRecord> runs;
  std::vector<Sample> flight_recorder;  ///< the last samples before a fault
};

}  // namespace clampd
