#include "clampd/archive/raw_data.hpp"

#include <filesystem>

#include <fmt/format.h>

#include "clampd/record/run.hpp"

namespace clampd {

Result<std::string> format_flight_recorder(const CheckRecord& check) {
  if (check.flight_recorder.empty())
    return failure(
        fmt::format("check {} has no flight recorder: it did not end in a fault of the station", check.id));
  std::string text =
      "sample_index,time_s,torque_Nm,velocity_rad_s,force_N,position_rad,torque_command_Nm,force_reference_N,"
      "lateness_us,trajectory_index,repeat,state,phase,fault\n";
  const Sample& last = check.flight_recorder.back();
  for (const Sample& s : check.flight_recorder)
    text += fmt::format("{},{:.6f},{},{},{},{},{},{},{:.3f},{},{},{},{},{}\n", s.sample_index,
                        static_cast<double>(s.brake_time_ns - last.brake_time_ns) * 1e-9, s.torque_Nm,
                        s.velocity_rad_s, s.force_N, s.position_rad, s.torque_command_Nm, s.force_reference_N,
                        s.lateness_ns * 1e-3, s.trajectory_index, s.repeat + 1, to_string(s.state),
                        to_string(s.phase), to_string(s.fault));
  return text;
}

Result<std::size_t> write_run_files(const CheckRecord& check, const std::string& folder) {
  namespace fs = std::filesystem;
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return failure(fmt::format("cannot make the folder {}: {}", folder, error.message()));
  std::size_t written = 0;
  for (std::size_t i = 0; i < check.runs.size(); ++i) {
    if (check.runs[i].run.size() == 0) continue;
    const std::string path = (fs::path(folder) / fmt::format("run-{:02}.csv", i + 1)).string();
    if (fs::exists(path, error))
      return failure(fmt::format("{}: is there already; name another folder", path));
    if (const Result<void> done = write_run(path, check.runs[i].run); !done)
      return tl::unexpected(done.error());
    ++written;
  }
  if (written > 0) return written;
  return failure(
      check.runs.empty()
          ? fmt::format("check {} recorded no runs", check.id)
          : fmt::format("the raw runs of check {} were removed on {}, as the station's [retention] says",
                        check.id, check.runs.front().removed));
}

}  // namespace clampd
