#include <filesystem>
#include <memory>

#include <algorithm>

#include <fmt/format.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include "clampd/bench/prepared_station.hpp"
#include "clampd/bench/publishing.hpp"
#include "drivers/can/socketcan.hpp"
#include "drivers/gpio/lines.hpp"
#include "rt/readiness.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

using rt::ReadinessFact;
using rt::ReadinessStatus;

struct DoctorOptions {
  std::string interface;
  double seconds = 2.0;
  bool json = false;
};

ReadinessFact examine_can(const std::string& interface, const CanSettings& bus, bool flexible_data_rate) {
  const std::uint32_t bitrate = bus.bitrate;
  const std::string rates =
      flexible_data_rate ? fmt::format("{} dbitrate {} fd on", bitrate, std::max(bitrate, bus.data_bitrate))
                         : std::to_string(bitrate);
  if (interface.empty()) {
    if (can::kernel_has_can())
      return {"CAN", ReadinessStatus::Ok,
              "the kernel has CAN; no interface is configured, so checks use the embedded simulated brake",
              ""};
    return {"CAN", ReadinessStatus::Warn, "this kernel has no CAN; checks use the embedded simulated brake",
            "for a real brake: a kernel with CONFIG_CAN_RAW (Debian's linux-image-amd64 has it) and a CAN "
            "interface"};
  }
  const Result<can::InterfaceInfo> info = can::inspect_interface(interface);
  if (!info) return {"CAN " + interface, ReadinessStatus::Fail, "not usable", info.error().message};
  if (!info->up)
    return {"CAN " + interface, ReadinessStatus::Fail, "down",
            fmt::format("ip link set {} up type can bitrate {}", interface, rates)};
  if (flexible_data_rate && !info->flexible_data_rate)
    return {"CAN " + interface, ReadinessStatus::Fail, "not set up for CAN FD, which the brake's frames need",
            fmt::format("ip link set {0} down; ip link set {0} up type can bitrate {1}", interface, rates)};
  if (bus.data_bitrate != 0 && info->data_bitrate != 0 && info->data_bitrate != bus.data_bitrate)
    return {
        "CAN " + interface, ReadinessStatus::Fail,
        fmt::format("CAN FD data run at {} bit/s, configured are {}", info->data_bitrate, bus.data_bitrate),
        fmt::format("ip link set {0} down; ip link set {0} up type can bitrate {1}", interface, rates)};
  if (info->bitrate != 0 && info->bitrate != bitrate)
    return {"CAN " + interface, ReadinessStatus::Fail,
            fmt::format("runs at {} bit/s, configured are {}", info->bitrate, bitrate),
            fmt::format("ip link set {0} down; ip link set {0} up type can bitrate {1}", interface, rates)};
  return {"CAN " + interface, ReadinessStatus::Ok,
          fmt::format("up, {}", info->bitrate == 0 ? "virtual" : fmt::format("{} bit/s", info->bitrate)), ""};
}

ReadinessFact examine_load(const StationConfiguration& configuration, const can::ProtocolCodec& codec) {
  constexpr double kRoomNeeded = 0.75;
  const std::uint32_t bitrate = configuration.can.bitrate;
  const double load = can::bus_load(codec, bitrate, bench::bus_format(configuration, codec).data_speedup);
  return {"CAN bus load", load <= kRoomNeeded ? ReadinessStatus::Ok : ReadinessStatus::Fail,
          fmt::format("{:.0f} % of {} bit/s at worst", 100.0 * load, bitrate),
          load <= kRoomNeeded
              ? ""
              : fmt::format("more than {:.0f} % leaves no room for a frame that has to be sent again: raise "
                            "can.bitrate or "
                            "can.data_bitrate, or have fewer, shorter or less frequent frames",
                            100.0 * kRoomNeeded)};
}

ReadinessFact examine_database(const std::string& database) {
  namespace fs = std::filesystem;
  fs::path folder = fs::path(database).parent_path();
  std::error_code failed;
  while (!folder.empty() && !fs::exists(folder, failed)) folder = folder.parent_path();
  if (access(folder.c_str(), W_OK) != 0)
    return {"results", ReadinessStatus::Fail, fmt::format("{} is not writable", folder.string()),
            "set [archive] database, or give the station's user the right to write there"};
  const fs::space_info space = fs::space(folder, failed);
  constexpr std::uintmax_t kEnough = 1ULL << 30;
  const double free_gigabytes = static_cast<double>(space.available) / static_cast<double>(kEnough);
  return {"results", !failed && space.available >= kEnough ? ReadinessStatus::Ok : ReadinessStatus::Warn,
          fmt::format("{}, {:.1f} GiB free", database, free_gigabytes),
          space.available >= kEnough ? "" : "a check takes about 0.15 MB; make room"};
}

void examine_panel(const gpio::PanelSettings& panel, std::vector<ReadinessFact>& facts) {
  for (std::size_t i = 0; i < gpio::kLineRoles; ++i) {
    const auto role = static_cast<gpio::LineRole>(i);
    if (!panel.lines[i].used()) continue;
    const std::string name = fmt::format("panel, {}", to_string(role));
    const Result<gpio::LineInfo> info = gpio::inspect_line(panel.lines[i], role);
    if (!info) {
      facts.push_back({name, ReadinessStatus::Fail, "not usable", info.error().message});
      continue;
    }
    const bool ours = info->consumer.empty() || info->consumer == "clampd";
    facts.push_back(
        {name, ours ? ReadinessStatus::Ok : ReadinessStatus::Fail,
         fmt::format("{} line {}{}{}", info->chip, info->offset, info->name.empty() ? "" : " " + info->name,
                     info->consumer.empty() ? "" : ", in use by " + info->consumer),
         ours ? "" : "end that program, or name another line in [gpio]"});
  }
}

void examine_publishing(const StationConfiguration& configuration, std::vector<ReadinessFact>& facts) {
  const Result<CheckStore> store = CheckStore::open(configuration.database, CheckStore::Access::ReadOnly);
  for (const bench::ChannelReport& channel : bench::try_channels(configuration, store ? &*store : nullptr)) {
    facts.push_back({"publishing, " + channel.channel,
                     channel.error.empty() ? ReadinessStatus::Ok : ReadinessStatus::Warn,
                     fmt::format("{} {}, {}", channel.where, channel.connected ? "answers" : "cannot be used",
                                 bench::waiting_text(channel.pending, channel.oldest_age_s)),
                     channel.error});
    if (const std::string warning = bench::password_warning(configuration, channel.channel); !warning.empty())
      facts.push_back({"password, " + channel.channel, ReadinessStatus::Warn, "not protected", warning});
  }
}

void print_facts(const std::vector<ReadinessFact>& facts) {
  const bool colour = cli::colours_wanted();
  for (const ReadinessFact& fact : facts) {
    const char* paint = fact.status == ReadinessStatus::Ok     ? "\033[32m"
                        : fact.status == ReadinessStatus::Warn ? "\033[33m"
                                                               : "\033[1;31m";
    fmt::print("{}{:<5}{} {:<22} {}\n", colour ? paint : "", to_string(fact.status), colour ? "\033[0m" : "",
               fact.name, fact.found);
    if (!fact.advice.empty()) fmt::print("      {:<22} -> {}\n", "", fact.advice);
  }
}

int doctor(const DoctorOptions& options, const CommonOptions& common) {
  const Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  const Result<bench::PreparedStation> station = bench::prepare_station(*configuration);
  if (!station) return cli::refuse(station.error());
  const std::string interface = options.interface.empty() ? configuration->can.interface : options.interface;
  if (!options.interface.empty())
    if (const Result<can::InterfaceInfo> info = can::inspect_interface(interface); !info)
      return cli::refuse(info.error());

  rt::ReadinessOptions readiness;
  readiness.priority = configuration->realtime.priority;
  readiness.cpu = configuration->realtime.cpu;
  readiness.jitter_test_ns = static_cast<std::int64_t>(options.seconds * 1e9);
  std::vector<ReadinessFact> facts = rt::examine_readiness(readiness);
  facts.push_back(examine_can(interface, configuration->can, station->codec.needs_flexible_data_rate()));
  facts.push_back(examine_load(*configuration, station->codec));
  if (station->panel) examine_panel(*station->panel, facts);
  facts.push_back(examine_database(configuration->database));
  examine_publishing(*configuration, facts);

  bool fit = true;
  for (const ReadinessFact& fact : facts) fit = fit && fact.status != ReadinessStatus::Fail;
  if (options.json) {
    nlohmann::ordered_json document{{"schema", "clampd.doctor/1"}, {"fit", fit}};
    auto& list = document["facts"] = nlohmann::ordered_json::array();
    for (const ReadinessFact& fact : facts)
      list.push_back({{"name", fact.name},
                      {"status", to_string(fact.status)},
                      {"found", fact.found},
                      {"advice", fact.advice}});
    fmt::print("{}\n", document.dump(2));
  } else {
    print_facts(facts);
    fmt::print("\n{}\n", fit ? "This machine can run a station."
                             : "This machine cannot run a station yet: see the lines marked fail.");
  }
  return fit ? cli::kSuccess : cli::kStation;
}

}  // namespace

void add_doctor_command(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto options = std::make_shared<DoctorOptions>();
  CLI::App* command =
      app.add_subcommand("doctor", "can this machine do real time and CAN, and what to change");
  command->add_option("--interface", options->interface,
                      "CAN interface to look at (default: the configured one)");
  command->add_option("--seconds", options->seconds, "how long to measure wake-up lateness")
      ->check(CLI::Range(0.5, 600.0))  // less sees nothing
      ->capture_default_str();
  command->add_flag("--json", options->json, "as JSON on standard output");
  command->callback([options, &common, &exit_code] { exit_code = doctor(*options, common); });
}

}  // namespace clampd::ctl
