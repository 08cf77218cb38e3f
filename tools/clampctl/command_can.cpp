// clampctl can check: what a station would understand of a brake's frames, from a log of them.

#include <memory>
#include <string>

#include <fmt/format.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "clampd/bench/prepared_station.hpp"
#include "clampd/record/file.hpp"
#include "drivers/can/log.hpp"
#include "drivers/can/log_check.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {
namespace {

using Json = nlohmann::ordered_json;

struct CanCheckOptions {
  std::string log;
  std::string dbc;
  bool json = false;
};

Json to_json(const can::FrameFinding& frame) {
  Json json{{"message", frame.message},
            {"id", can::id_text(frame.id)},
            {"from", frame.from_brake ? "brake" : "station"},
            {"seen", frame.seen},
            {"good", frame.good()},
            {"wrong_size", frame.wrong_size},
            {"wrong_format", frame.wrong_format},
            {"wrong_checksum", frame.wrong_checksum},
            {"other_content", frame.other_content},
            {"counter_repeats", frame.counter_repeats},
            {"counter_jumps", frame.counter_jumps}};
  if (frame.spacing)
    json["period_ms"] = {{"median", frame.spacing->median_ms},
                         {"least", frame.spacing->least_ms},
                         {"most", frame.spacing->most_ms}};
  json["signals"] = Json::array();
  for (const can::SignalFinding& signal : frame.signals) {
    Json entry{{"name", signal.name}, {"unit", signal.unit}, {"implausible", signal.implausible}};
    if (signal.least <= signal.most) {
      entry["least"] = signal.least;
      entry["most"] = signal.most;
    }
    json["signals"].push_back(std::move(entry));
  }
  if (!frame.other_checksums.empty()) json["other_checksums"] = frame.other_checksums;
  return json;
}

Json to_json(const std::map<std::uint32_t, can::OtherFrame>& others) {
  Json list = Json::array();
  for (const auto& [id, other] : others) {
    Json entry{{"id", can::id_text(id)}, {"seen", other.seen}};
    if (!other.message.empty()) entry["message"] = other.message;
    list.push_back(std::move(entry));
  }
  return list;
}

Json to_json(const can::FrameLog& log, const can::LogFinding& finding, const std::string& dbc) {
  Json json{{"schema", "clampd.can-check/1"},
            {"dbc", dbc},
            {"understood", finding.problems.empty()},
            {"frames", log.frames.size()},
            {"duration_s", finding.duration_s},
            {"unreadable_lines", log.unreadable},
            {"samples", finding.samples},
            {"lost_samples", finding.counts.lost_samples},
            {"arrival_jitter_ms", finding.arrival_jitter_ms},
            {"expected", Json::array()},
            {"others", to_json(finding.others)},
            {"problems", finding.problems},
            {"notes", finding.notes}};
  for (const can::FrameFinding& frame : finding.frames) json["expected"].push_back(to_json(frame));
  return json;
}

void print_log(const can::FrameLog& log, double duration_s, const std::string& name, const std::string& dbc) {
  fmt::print("{}: {} frames{}, read by {}", name, log.frames.size(),
             duration_s > 0.0 ? fmt::format(" in {:.1f} s", duration_s) : ", without time stamps", dbc);
  if (log.unreadable > 0)
    fmt::print("; {} lines are no frames, the first of them line {}", log.unreadable, log.first_unreadable);
  fmt::print("\n\n");
}

void print_frame(const can::FrameFinding& frame) {
  fmt::print("{:<8} {:<24} {:<12} {:>8} seen", can::id_text(frame.id), frame.message,
             frame.from_brake ? "from brake" : "to brake", frame.seen);
  if (frame.seen > 0) fmt::print(", {} good", frame.good());
  if (frame.spacing)
    fmt::print(", every {:.2f} ms ({:.2f} to {:.2f})", frame.spacing->median_ms, frame.spacing->least_ms,
               frame.spacing->most_ms);
  fmt::print("\n");
  for (const can::SignalFinding& signal : frame.signals) {
    if (signal.least > signal.most) continue;
    fmt::print("         {:<24} {:g} to {:g} {}\n", signal.name, signal.least, signal.most, signal.unit);
  }
}

void print_others(const std::map<std::uint32_t, can::OtherFrame>& others) {
  if (others.empty()) return;
  constexpr std::size_t kMost = 12;
  fmt::print("\nFrames that the mapping does not name:\n");
  std::size_t shown = 0;
  for (const auto& [id, other] : others) {
    if (shown++ == kMost) {
      fmt::print("         and {} more\n", others.size() - kMost);
      break;
    }
    fmt::print("{:<8} {:<24} {:>21} seen\n", can::id_text(id),
               other.message.empty() ? "not in the DBC file" : other.message, other.seen);
  }
}

void print_finding(const can::LogFinding& finding) {
  for (const can::FrameFinding& frame : finding.frames) print_frame(frame);
  print_others(finding.others);
  fmt::print("\nThe station would have taken {} samples; {} are missing between them.\n", finding.samples,
             finding.counts.lost_samples);
  const bool colour = cli::colours_wanted();
  const auto list = [&](const char* word, const char* paint, const std::vector<std::string>& texts) {
    for (const std::string& text : texts)
      fmt::print("{}{}{} {}\n", colour ? paint : "", word, colour ? "\033[0m" : "", text);
  };
  if (!finding.problems.empty() || !finding.notes.empty()) fmt::print("\n");
  list("problem:", "\033[1;31m", finding.problems);
  list("note:", "\033[33m", finding.notes);
  fmt::print("\n{}\n", finding.problems.empty()
                           ? "A station with this configuration understands this brake."
                           : "A station with this configuration does not understand this brake yet.");
}

/// Why the configuration gives no frames, and what the log has beside what the DBC file knows.
int refuse_frames(const Error& error, const can::FrameLog& log, const bench::FrameDescription& frames,
                  const CanCheckOptions& options) {
  if (options.json) {
    const Json json{{"schema", "clampd.can-check/1"},
                    {"dbc", frames.database.file},
                    {"understood", false},
                    {"frames", log.frames.size()},
                    {"problems", {error.message}},
                    {"others", to_json(can::identifiers(log, frames.database))}};
    fmt::print("{}\n", json.dump(2));
  } else {
    print_others(can::identifiers(log, frames.database));
    fmt::print("\n");
  }
  return cli::refuse(error);
}

can::Demands demands_of(const StationConfiguration& configuration) {
  const SupervisorSettings& limits = configuration.supervisor;
  const double torque_Nm = configuration.check.torque_limit_Nm, speed_rad_s = limits.over_speed_rad_s;
  return {.torque = {-torque_Nm, torque_Nm, limits.torque_mismatch_Nm},
          .velocity = {-speed_rad_s, speed_rad_s, limits.velocity_mismatch_rad_s},
          .position = {0.0, 0.0, limits.position_mismatch_rad},
          .force = {0.0, limits.over_force_N, limits.force_mismatch_N}};
}

int check_log_file(const CanCheckOptions& options, const CommonOptions& common) {
  Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  if (!options.dbc.empty()) configuration->can.dbc = options.dbc;
  const Result<bench::FrameDescription> frames = bench::read_frames(*configuration);
  if (!frames) return cli::refuse(frames.error());
  const Result<std::string> text = read_file(options.log);
  if (!text) return cli::refuse(text.error());
  const Result<can::FrameLog> log = can::parse_log(*text, options.log);
  if (!log) return cli::refuse(log.error());
  const Result<can::ProtocolCodec> codec = can::ProtocolCodec::build(frames->database, frames->mapping);
  if (!codec) return refuse_frames(codec.error(), *log, *frames, options);
  can::LogFinding finding = can::check_log(*log, frames->database, frames->mapping, *codec);
  can::note_demands(*codec, demands_of(*configuration), finding);
  if (options.json) {
    fmt::print("{}\n", to_json(*log, finding, frames->database.file).dump(2));
  } else {
    print_log(*log, finding.duration_s, options.log, frames->database.file);
    print_finding(finding);
  }
  return finding.problems.empty() ? cli::kSuccess : cli::kStation;
}

}  // namespace

void add_can_command(CLI::App& app, const CommonOptions& common, int& exit_code) {
  CLI::App* can = app.add_subcommand("can", "the brake's frames");
  can->require_subcommand(1);
  auto options = std::make_shared<CanCheckOptions>();
  CLI::App* command = can->add_subcommand(
      "check", "what a station would understand of a log of a brake's frames, and what is missing");
  command->add_option("log", options->log, "a log as candump writes it (candump -l can0)")
      ->required()
      ->type_name("LOG");
  command->add_option("--dbc", options->dbc, "another DBC file than the configured one")->type_name("FILE");
  command->add_flag("--json", options->json, "as JSON on standard output");
  command->callback([options, &common, &exit_code] { exit_code = check_log_file(*options, common); });
}

}  // namespace clampd::ctl
