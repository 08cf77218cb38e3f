#include <cstdint>
#include <limits>
#include <string>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "clampd/base/entropy.hpp"
#include "clampd/base/version.hpp"
#include "clampd/publish/wake_event.hpp"
#include "tools/cli/exit_code.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"
#include "tools/factory/plan.hpp"
#include "tools/factory/stations.hpp"

namespace {

using namespace clampd;

int reveal(const std::string& folder) {
  const Result<factory::Settings> settings = factory::settings_of(folder);
  if (!settings) return cli::refuse(settings.error());
  fmt::print("{}: what this factory hides (seed {})\n", folder, settings->seed);
  for (const factory::Hidden& hidden : factory::hide(*settings))
    fmt::print("  {}\n", factory::describe(hidden, *settings));
  return cli::kSuccess;
}

int run(const std::string& folder, const factory::Settings& settings, const factory::Archive& archive) {
  publish::WakeEvent& wake = publish::stopped_by_signals();
  if (const Result<void> made = factory::open_archive(archive, wake).and_then([&] {
        return factory::furnish(folder, settings, archive);
      });
      !made)
    return cli::refuse(made.error());
  cli::ProgressLine line;
  const Result<factory::Summary> summary = factory::run_stations(
      folder, settings, wake, [&line](double share, const std::string& words) { line.show(share, words); });
  line.clear();
  if (!summary) {
    const int refused = cli::refuse(summary.error());
    return wake.stopped() ? cli::kAborted : refused;
  }
  fmt::print(
      "{} checks at {} stations over {} days, all in the database: {} PASS, {} FAIL, {} without a verdict; "
      "{:.0f} ms a check on one core\n",
      summary->checks(), settings.stations, settings.days, summary->passed, summary->failed, summary->invalid,
      1e3 * summary->busy_s / summary->checks());
  return cli::kSuccess;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "clampd-factory runs the simulated stations of a factory in virtual time; each publishes its checks "
      "with "
      "their runs to PostgreSQL. What the factory hides follows from the seed."};
  app.set_version_flag("--version", std::string(kVersion));
  app.footer("Exit codes: 0 done; 2 wrong usage or bad input; 4 ended by a signal.");
  std::string folder;
  factory::Settings settings;
  factory::Archive archive;
  app.add_option("--folder", folder, "for the stations' configurations and stores")
      ->required()
      ->type_name("FOLDER");
  bool revealed = false;
  app.add_flag("--reveal", revealed, "say what the factory in the folder hides, and do nothing else");
  bool validated = false;
  app.add_flag("--validate", validated, "say what is wrong with the arguments, and do nothing else");
  app.add_option("--stations", settings.stations, "how many")
      ->check(CLI::Range(2, 400))
      ->capture_default_str();
  app.add_option("--checks", settings.checks, "of all stations together")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option("--days", settings.days, "that the checks are spread over, from 2026-01-05 on")
      ->check(CLI::Range(1, 3'650))
      ->capture_default_str();
  CLI::Option* seed = app.add_option("--seed", settings.seed, "decides everything (default: drawn)")->check(CLI::Range(std::int64_t{0}, std::numeric_limits<std::int64_t>::max()));
  app.add_option("--repeats", settings.repeats, "of the trajectory in each check")
      ->check(CLI::Range(1, 200))
      ->capture_default_str();
  app.add_option("--host", archive.host, "of the database: name, address, or folder of its socket");
  app.add_option("--port", archive.port, "of the database")
      ->check(CLI::Range(1, 65'535))
      ->capture_default_str();
  app.add_option("--database", archive.database, "its name")->capture_default_str();
  app.add_option("--user", archive.user, "of the database (default: as the system calls you)");
  try {
    app.parse(argc, argv);
    if (!revealed && !validated && archive.host.empty()) throw CLI::RequiredError("--host");
  } catch (const CLI::Success& request) {
    return app.exit(request);
  } catch (const CLI::ParseError& mistake) {
    app.exit(mistake);
    return cli::kBadInput;
  }
  if (revealed) return reveal(folder);
  if (validated) return cli::kSuccess;
  // Few enough digits to be typed again.
  if (seed->count() == 0) settings.seed = entropy()() % 1'000'000U;
  return run(folder, settings, archive);
}
