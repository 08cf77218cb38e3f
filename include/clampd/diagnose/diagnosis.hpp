#pragma once

#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/brake/effect.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

enum class DiagnosisVerdict {
  Adequate,     ///< the base model explains the runs
  Explained,    ///< one or more named effects do
  Ambiguous,    ///< the cause is one of the rivals
  Unexplained,  ///< something is wrong that no known effect explains
};
std::string_view to_string(DiagnosisVerdict verdict) noexcept;  ///< "adequate", ...

/// An estimated parameter with its unit; sd is NaN where it has none.
struct EstimatedParameter {
  std::string name;
  std::string unit;
  double value = std::numeric_limits<double>::quiet_NaN();
  double sd = std::numeric_limits<double>::quiet_NaN();
  std::string choice = {};  ///< what the value is called, where it is one of a list
};

/// An effect that the diagnosis puts forward. With the verdict Ambiguous: the best of the rivals, or one that
/// is certain.
struct NamedEffect {
  std::string name;
  Location location = Location::TorqueBalance;
  std::vector<EstimatedParameter> parameters;
  double log_likelihood_gain = 0.0;  ///< nats that the model loses without it
  double p_value = 1.0;  ///< that a faultless brake shows as much, all candidates tried considered
  std::string words = {};  ///< what it does; empty: as the catalogue of a brake's effects says
};

/// One candidate on the ladder of evidence of one stage of the search.
struct CandidateSummary {
  int stage = 1;  ///< 1: alone beside the base model, 2: beside the first effect named, ...
  std::string name;
  Location location = Location::TorqueBalance;
  double predicted_gain = 0.0;                             ///< nats, by one Gauss-Newton step
  double gain = std::numeric_limits<double>::quiet_NaN();  ///< nats, refitted; NaN if not worth it
  int parameters = 0;                                      ///< estimated for it
  double significance_nats = 0.0;  ///< -ln p of the candidate by itself, its alternatives counted
  double p_value = 1.0;            ///< the same with all candidates counted
  std::vector<EstimatedParameter> values;
  bool chosen = false;
  bool rival = false;
};

struct UnseenEffect {
  std::string name;
  std::string reason;  ///< "no reversal under load"
};

/// Of a reading that is held: it depends on whether it repeats the row before.
inline constexpr std::string_view kRepetition = "repetition";

/// What the remaining misfit (of the base model, before any effect) depends on.
struct Dependence {
  std::string variable;  ///< "position", "velocity", "force", "time", "direction", "run", "torque", "rate",
                         ///< "repetition"
  Location location = Location::TorqueBalance;
  double gain = 0.0;  ///< nats that a free function of the variable there would gain
  double p_value = 1.0;
};

struct MisfitTest {
  std::string name;  ///< "whiteness of the force", "lack of fit against repeats", ...
  double statistic = 0.0;
  double p_value = 1.0;
  std::string words;  ///< what it means here
};

struct Misfit {
  std::vector<MisfitTest> tests_before;  ///< on the base model
  std::vector<MisfitTest> tests_after;   ///< on the model with the named effects
  std::vector<Dependence> dependences;   ///< strongest first; of what the final model leaves if the
                                         ///< runs are unexplained, or else of what the base model leaves
  std::optional<Location> location;      ///< of the strongest
  /// What the named effects explain, and what their model still leaves; of drives without a force reading 0.
  double explained_nats = 0.0;
  double left_nats = 0.0;
};

/// Before: the base model; after: with the named effects; both fitted to the same runs, judged on runs held
/// out of the fit. One-step predictions of the Kalman filter unless it says simulated.
struct GainFigures {
  double rms_force_N = 0.0;
  double rms_velocity_rad_s = 0.0;
  double simulated_rms_force_N = 0.0;
  double simulated_rms_velocity_rad_s = 0.0;
  double log_likelihood_per_sample = 0.0;
  double whiteness_p_value = 1.0;
  /// Mean square innovation over its expected value by the noise of the model with the named effects, before
  /// and after: 1 at the noise floor.
  double misfit = 1.0;
  /// Of drives without a force reading, judged by the torque that their motion needs.
  double rms_torque_Nm = std::numeric_limits<double>::quiet_NaN();
  double torque_error_relative = std::numeric_limits<double>::quiet_NaN();
};
struct HeldOutGain {
  GainFigures before;
  GainFigures after;
  std::vector<std::string> runs;  ///< names of the held-out ones; empty if there were none to spare
};

/// One run, measured against simulated before and after; for pictures.
struct RunView {
  std::string name;
  std::vector<double> time_s, torque_Nm, position_rad;
  struct Channel {
    std::vector<double> measured, before, after;            ///< one-step predictions
    std::vector<double> simulated_before, simulated_after;  ///< free simulation with estimated torque errors
    std::vector<double> residual_before, residual_after;    ///< innovations over their standard deviation
  } force, velocity;
  std::vector<double> disturbance_before_Nm, disturbance_after_Nm;  ///< smoothed error of the torque balance
};

/// The run that would settle the rivals.
struct NextExperiment {
  std::string manoeuvre;  ///< a name for it
  std::string why;
  Run trajectory;   ///< of the nominal brake, as `clampctl simulate --trajectory` takes it
  int repeats = 1;  ///< of the trajectory that this takes
  double expected_evidence_nats = 0.0;  ///< of all repeats, between the two rivals hardest to tell apart
};

/// What was found about the data before any model.
struct DataFinding {
  enum class Severity { Note, Mended, Stop };
  std::string name;    ///< "velocity-scale", "held-readings", ...: those of `diagnose --json`
  std::string column;  ///< as the file calls it; empty: none of its own
  std::string run;     ///< name of the first run in which it is found
  double size = std::numeric_limits<double>::quiet_NaN();
  std::string unit;  ///< of the size
  Severity severity = Severity::Note;
  std::string words;  ///< what, where, how much, what to do
  double sd = std::numeric_limits<double>::quiet_NaN();  ///< of the size; NaN where it has none
};
std::string_view to_string(DataFinding::Severity severity) noexcept;  ///< "note", "mended", "stop"

/// Rows of the files, and why some were not used.
struct RowCount {
  std::size_t read = 0, used = 0;
  struct LeftOut {
    std::string reason;
    std::size_t rows = 0;
  };
  std::vector<LeftOut> left_out;
};

struct Diagnosis {
  DiagnosisVerdict verdict = DiagnosisVerdict::Adequate;
  std::string summary;  ///< one sentence for a technician
  std::vector<NamedEffect> effects;
  std::vector<std::vector<std::string>> rivals;  ///< each group: names that these data cannot tell apart
  /// The same groups with what each rival makes of the runs, for whoever designs an experiment between them.
  struct Rival {
    std::string name;
    ExtendedParameters model;
    Eigen::MatrixXd covariance;  ///< of ExtendedBrake's parameters, SI
  };
  std::vector<std::vector<Rival>> rival_models;
  std::vector<UnseenEffect> unseen;
  Misfit misfit;
  std::vector<CandidateSummary> candidates;
  double alarm_evidence =
      std::numeric_limits<double>::quiet_NaN();  ///< from which on a rung raises the alarm
  std::optional<HeldOutGain> gain;
  std::vector<EstimatedParameter> parameters_before;
  std::vector<EstimatedParameter> parameters_after;
  ExtendedParameters model;  ///< with the named effects
  NoiseLevels noise_before, noise_after;
  std::optional<TorqueWhileOff> torque_while_off;  ///< if it was recorded
  std::optional<NextExperiment> next_experiment;   ///< left empty by diagnose(): experiment designs it
  std::vector<std::string> notices;                ///< what these data could not show, what was left out
  std::vector<RunView> views;                      ///< if asked for
  std::vector<DataFinding> data;                   ///< of bare drives
  RowCount rows;                                   ///< of bare drives
  /// Of bare drives: what is left of the torque's variation, rms over rms, on rows that were not fitted. NaN: unknown.
  double share_left = std::numeric_limits<double>::quiet_NaN();
  /// Of its square, what any function of the recorded columns could take, held out. NaN: unknown.
  double share_explainable = std::numeric_limits<double>::quiet_NaN();
  double wall_s = 0.0;
};

struct DiagnoseOptions {
  BrakeParameters nominal;  ///< start values; J and N as known
  /// Judged by but never fitted to. Empty: every third run is held out for the gain, and the final model is
  /// then fitted to all.
  std::span<const Run> heldout = {};
  /// Recorded elsewhere, beside what the runs hold of it.
  std::optional<TorqueWhileOff> torque_while_off = {};
  /// Standard deviations of the zeros that a tare has given to the readings, if it is known: offsets of that
  /// size are taken into account and not named.
  std::optional<SensorNoise> tare_sd = {};
  bool views = false;  ///< fill Diagnosis::views
  int threads = 0;     ///< 0: as many as there are processors
  int most_effects = 4;
  double false_alarm = 0.005;  ///< chance that an effect is named in a faultless set
  /// Called from one thread at a time with the share done and what is being done.
  std::function<void(double, const std::string&)> progress;
  /// Asked now and then, from any thread: true, which it then stays, ends the search with an error.
  std::function<bool()> given_up;
};

/// Says whether the base model explains the runs, and if not what does. Runs in chronological order; needs
/// force and velocity readings. Where the drive was off throughout a run, only its torque reading counts: no
/// torque acted then. Errors: no run, none with the drive on, a run that is too short or not finite, a base
/// model that cannot be fitted at all.
Result<Diagnosis> diagnose(std::span<const Run> runs, const DiagnoseOptions& options);

}  // namespace clampd
