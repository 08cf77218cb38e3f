#include <unistd.h>

#include <string>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "clampd/base/version.hpp"
#include "clampd/publish/wake_event.hpp"
#include "clampd/reanalysis/database.hpp"
#include "clampd/reanalysis/worker.hpp"
#include "clampd/station/configuration.hpp"
#include "tools/clampd-worker/server.hpp"
#include "tools/cli/exit_code.hpp"
#include "tools/cli/output.hpp"

namespace {

constexpr const char* kInstalled = "/etc/clampd/station.toml";

std::string host_and_process() {
  char host[256] = "";
  ::gethostname(host, sizeof host - 1);
  return fmt::format("{}:{}", host, ::getpid());
}

}  // namespace

int main(int argc, char** argv) {
  using namespace clampd;
  CLI::App app{
      "clampd-worker identifies archived runs anew: it takes tasks from the database that `clampctl archive "
      "submit` "
      "filled, one at a time. Any number of workers share the work."};
  app.set_version_flag("--version", std::string(kVersion));
  app.footer(
      "Exit codes: 0 ended by a signal, or nothing left; 2 wrong usage, wrong schema or missing rights.");
  std::string config = kInstalled;
  reanalysis::WorkerOptions options;
  options.name = host_and_process();
  int lease_s = 60;
  app.add_option("--config", config, "a station's configuration, of which [postgresql] is used")
      ->type_name("FILE")
      ->capture_default_str();
  app.add_flag("--until-empty", options.until_empty,
               "end once no task is waiting, and none is claimed by a worker that may not come to its end");
  app.add_option("--lease", lease_s, "seconds after which others take over the task of a worker that died")
      ->check(CLI::Range(3, 86'400))
      ->capture_default_str();
  std::string serve_at;
  app.add_option("--serve,--metrics", serve_at,
                 "serve the page of the line at http://ADDRESS:PORT/ (stations, drift, capability side by "
                 "side, who does what), the document that it is drawn from at /line.json, and what this "
                 "worker does at /metrics, for Prometheus")
      ->type_name("ADDRESS:PORT");
  app.add_option("--name", options.name, "of this worker, in the queue and with its results")
      ->capture_default_str();
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& request) {
    return app.exit(request);
  } catch (const CLI::ParseError& mistake) {
    app.exit(mistake);
    return cli::kBadInput;
  }
  options.lease = std::chrono::seconds(lease_s);
  options.say = [](const std::string& words) {
    fmt::print(stderr, "{}\n", words);
    std::fflush(stderr);
  };

  const Result<publish::PostgresqlSettings> archive =
      read_station_configuration(config).and_then(reanalysis::archive_of);
  if (!archive) return cli::refuse(archive.error());
  options.database = *archive;
  publish::WakeEvent& wake = publish::stopped_by_signals();
  worker::Server server(options.name, options.database);
  if (!serve_at.empty()) {
    if (const Result<void> started = server.start(serve_at); !started) return cli::refuse(started.error());
    options.report = [&server](const reanalysis::WorkerStatus& status) { server.set(status); };
  }
  const Result<reanalysis::WorkerSummary> summary = reanalysis::work(options, wake);
  if (!summary) return cli::refuse(summary.error());
  fmt::print("{} done ({} of them known before), {} failed, {} lost, {} given back\n", summary->done,
             summary->known, summary->failed, summary->lost, summary->given_back);
  return cli::kSuccess;
}
