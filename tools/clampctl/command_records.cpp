#include <algorithm>
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/record/utc.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

constexpr std::size_t kListedDamage = 50;

nlohmann::ordered_json verification_json(const std::string& database, const Verification& found) {
  nlohmann::ordered_json damage = nlohmann::ordered_json::array();
  for (const Verification::Damage& one : found.damage)
    damage.push_back(
        {{"record", one.check.empty() ? nlohmann::ordered_json(nullptr) : nlohmann::ordered_json(one.check)},
         {"what", one.what}});
  return {{"schema", "clampd.verification/1"},  {"database", database},
          {"intact", found.damage.empty()},     {"checks", found.checks},
          {"amendments", found.amendments},     {"runs", found.runs},
          {"runs_removed", found.runs_removed}, {"chain_sha256", found.chain_sha256},
          {"damage", std::move(damage)}};
}

std::string format_verification(const std::string& database, const Verification& found) {
  std::string text = fmt::format("{}: {} checks, {} raw runs ({} more removed by retention), {} amendments\n",
                                 database, found.checks, found.runs, found.runs_removed, found.amendments);
  for (std::size_t i = 0; i < std::min(kListedDamage, found.damage.size()); ++i) {
    const Verification::Damage& one = found.damage[i];
    text += fmt::format("  {}{}{}\n", one.check, one.check.empty() ? "" : ": ", one.what);
  }
  if (found.damage.size() > kListedDamage)
    text += fmt::format("  and {} more; --json lists all\n", found.damage.size() - kListedDamage);
  text += found.damage.empty()
              ? fmt::format("All as it was recorded. Chain of checksums: {}\n", found.chain_sha256)
              : fmt::format("{} places are damaged; everything else is as it was recorded.\n",
                            found.damage.size());
  return text;
}

/// The named file, or the configured database.
Result<std::string> database_of(const std::string& file, const CommonOptions& common) {
  if (!file.empty()) return file;
  return bench::load_configuration(common.config).map([](const StationConfiguration& configuration) {
    return configuration.database;
  });
}

int verify(const std::string& file, bool json, const CommonOptions& common) {
  const Result<std::string> database = database_of(file, common);
  if (!database) return cli::refuse(database.error());
  std::error_code ignored;
  const Result<CheckStore> store = CheckStore::open(*database, CheckStore::Access::ReadOnly);
  if (!store) {
    cli::print_error(store.error().message);
    return std::filesystem::exists(*database, ignored) ? cli::kStation : cli::kBadInput;
  }
  cli::ProgressLine line;
  const Result<Verification> found =
      store->verify([&line](double share) { line.show(share, "checks, runs and their chain of checksums"); });
  line.clear();
  if (!found) {
    cli::print_error(found.error().message);
    return cli::kStation;
  }
  if (json)
    fmt::print("{}\n", verification_json(*database, *found).dump(2));
  else
    fmt::print("{}", format_verification(*database, *found));
  return found->damage.empty() ? cli::kSuccess : cli::kStation;
}

int back_up(const std::string& file, const CommonOptions& common) {
  const Result<std::string> database = database_of("", common);
  if (!database) return cli::refuse(database.error());
  const Result<void> done =
      CheckStore::open(*database, CheckStore::Access::ReadOnly).and_then([&](const CheckStore& store) {
        return store.back_up(file);
      });
  if (!done) return cli::refuse(done.error());
  fmt::print("{}\n", file);
  return cli::kSuccess;
}

int restore(const std::string& file, const CommonOptions& common) {
  const Result<std::string> database = database_of("", common);
  if (!database) return cli::refuse(database.error());
  const Result<std::string> kept = restore_backup(file, *database, utc_now_ns());
  if (!kept) return cli::refuse(kept.error());
  fmt::print("{} is as {} was.{}\n", *database, file,
             kept->empty() ? "" : fmt::format(" What was there before is in {}.", *kept));
  return cli::kSuccess;
}

}  // namespace

void add_records_commands(CLI::App& app, const CommonOptions& common, int& exit_code) {
  CLI::App* records = app.add_subcommand("records", "the database of results: verify, back up, restore");
  records->require_subcommand(1);

  struct VerifyOptions {
    std::string file;
    bool json = false;
  };
  auto options = std::make_shared<VerifyOptions>();
  CLI::App* verification =
      records->add_subcommand("verify",
                              "compare every record with its checksum and every checksum with the one "
                              "before; names what is damaged (exit "
                              "code 3) and goes on with the rest");
  verification->add_option("file", options->file,
                           "this file, for example a backup (default: the station's database)");
  verification->add_flag("--json", options->json, "as JSON on standard output");
  verification->callback(
      [options, &common, &exit_code] { exit_code = verify(options->file, options->json, common); });

  auto copy = std::make_shared<std::string>();
  CLI::App* backup =
      records->add_subcommand("backup", "copy the database into a new file, also while the station runs");
  backup->add_option("file", *copy, "where to")->required();
  backup->callback([copy, &common, &exit_code] { exit_code = back_up(*copy, common); });

  auto from = std::make_shared<std::string>();
  CLI::App* restoration = records->add_subcommand("restore",
                                                  "put a backup in the place of the database, also while the "
                                                  "station runs; the backup is verified first, and what "
                                                  "was there is kept beside it");
  restoration->add_option("file", *from, "the backup")->required();
  restoration->callback([from, &common, &exit_code] { exit_code = restore(*from, common); });
}

}  // namespace clampd::ctl
