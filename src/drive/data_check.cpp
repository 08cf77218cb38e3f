#include "src/drive/data_check.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>

#include <fmt/format.h>

namespace clampd {
namespace {

using data_check::RunCheck;

Result<void> check_shape(const Run& run) {
  const std::size_t n = run.size();
  const bool whole =
      run.torque_Nm.size() == n && (run.velocity_rad_s.empty() || run.velocity_rad_s.size() == n) &&
      (run.position_rad.empty() || run.position_rad.size() == n) &&
      (run.force_N.empty() || run.force_N.size() == n) &&
      (run.drive_enabled.empty() || run.drive_enabled.size() == n) &&
      std::ranges::all_of(run.others, [n](const RunColumn& column) { return column.values.size() == n; });
  if (!whole)
    return failure(fmt::format("{}: its columns differ in length; each needs one reading a row", run.name));
  if (run.velocity_rad_s.empty() && run.position_rad.empty())
    return failure(
        fmt::format("{}: neither position nor velocity; name a column in the model file", run.name));
  return {};
}

bool has_stop(const RunCheck& check) {
  return std::ranges::any_of(check.findings,
                             [](const DataFinding& each) { return each.severity == DataSeverity::Stop; });
}

/// What is mended first spoils what is looked at later: a held position looks like jumps, a wrap like a
/// spike, a spike like a delay.
void check_run(RunCheck& check) {
  constexpr std::size_t kLeastRows = 20;  // fewer are refused by the diagnosis, with its own words
  if (!data_check::check_finite(check) || check.run.size() < kLeastRows) return;
  data_check::check_units(check);
  if (has_stop(check) || check.model.steady) return;  // of a steady run only the medians count
  data_check::check_gaps(check);
  data_check::check_held(check);
  data_check::check_wraps_and_jumps(check);
  data_check::check_spikes(check);
  data_check::check_jitter(check);
  data_check::check_velocity_against_position(check);
  if (has_stop(check)) return;
  data_check::check_sampling(check);
  data_check::check_resolution(check);
  data_check::check_clipping(check);
  data_check::check_torque_against_motion(check);
}

/// A finding, and in how many runs there is one of its kind, column and severity. The largest speaks for all.
struct Merged {
  DataFinding finding;
  std::size_t runs = 1;
};

void merge(std::vector<Merged>& all, const DataFinding& finding) {
  const auto same = std::ranges::find_if(all, [&](const Merged& each) {
    return std::tie(each.finding.name, each.finding.column, each.finding.severity) ==
           std::tie(finding.name, finding.column, finding.severity);
  });
  if (same == all.end()) {
    all.push_back({finding});
    return;
  }
  ++same->runs;
  if (std::abs(finding.size) > std::abs(same->finding.size)) same->finding = finding;
}

/// The findings, those that stop first, with the runs that have them where there is more than one run.
std::vector<DataFinding> concluded(std::vector<Merged> merged, std::size_t runs) {
  std::ranges::stable_sort(merged, std::greater{}, [](const Merged& each) { return each.finding.severity; });
  std::vector<DataFinding> findings;
  for (Merged& each : merged) {
    DataFinding& finding = each.finding;
    if (runs > 1 && each.runs == 1 && !finding.run.empty())
      finding.words = fmt::format("{}: {}", finding.run, finding.words);
    else if (runs > 1 && each.runs > 1)
      finding.words = fmt::format("{} (in {} of {} runs; the figures are those of {})", finding.words,
                                  each.runs, runs, finding.run);
    findings.push_back(std::move(finding));
  }
  return findings;
}

}  // namespace

Result<CheckedData> check_data(std::span<const Run> runs, const DriveModel& model) {
  if (runs.empty()) return failure("no run to check");
  std::vector<RunCheck> checks;
  std::vector<data_check::MotionSummary> motions;
  std::vector<Merged> merged;
  bool mended = false, finite = true;
  for (const Run& run : runs) {
    if (Result<void> shaped = check_shape(run); !shaped) return tl::unexpected(shaped.error());
    RunCheck check{model, run};
    check_run(check);
    for (const DataFinding& finding : check.findings) {
      merge(merged, finding);
      finite = finite && finding.name != "not-finite";
    }
    mended = mended || check.mended;
    motions.push_back(finite ? data_check::summarise_motion(check) : data_check::MotionSummary{});
    checks.push_back(std::move(check));
  }
  if (finite) {
    std::vector<DataFinding> together;
    data_check::check_excitation(motions, checks, together);
    for (const DataFinding& finding : together) merge(merged, finding);
  }
  CheckedData data;
  data.findings = concluded(std::move(merged), runs.size());
  if (!mended) return data;
  for (RunCheck& check : checks) data.runs.push_back(std::move(check.run));
  return data;
}

std::string stop_message(const CheckedData& data) {
  std::string message;
  for (const DataFinding& finding : data.findings)
    if (finding.severity == DataSeverity::Stop) message += (message.empty() ? "" : "; ") + finding.words;
  return message;
}

}  // namespace clampd
