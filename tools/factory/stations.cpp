#include "tools/factory/stations.hpp"

#include <chrono>
#include <filesystem>
#include <mutex>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"
#include "clampd/base/parallel.hpp"
#include "clampd/bench/embedded_station.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/bench/publishing.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/utc.hpp"

namespace clampd::factory {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kSettings = "factory.json";
/// Counted up where plan() or hide() draw otherwise than before.
constexpr const char* kSchema = "clampd.factory/1";
constexpr const char* kChannel = "postgresql";

std::string path_in(const std::string& folder, const std::string& name) {
  return (fs::path(folder) / name).string();
}

/// Texts as JSON writes them are texts of TOML, too.
std::string quoted(const std::string& text) {
  return ordered_json(text).dump();
}

std::string configuration_text(const std::string& name, const Settings& settings, const Archive& archive) {
  return fmt::format(
      "# Written by tools/dev factory: a simulated station, or whoever works with the database of all.\n"
      "[station]\nname = {0}\nfixture = {1}\npart_number = \"EMB-7\"\n\n"
      "[archive]\ndatabase = {2}\n\n"
      "[check]\nrepeats = {3}\ndiagnose = false # for the causes, ask `clampctl diagnose`: it takes "
      "seconds\n\n"
      "[postgresql]\nhost = {4}\nport = {5}\ndatabase = {6}\nuser = {7}\nraw_runs = true\n",
      quoted(name), quoted("fixture of " + name), quoted(name + ".sqlite"), settings.repeats,
      quoted(archive.host), archive.port, quoted(archive.database), quoted(archive.user));
}

/// Of all stations.
class Progress {
 public:
  Progress(int checks, const std::function<void(double, const std::string&)>& show)
      : checks_(checks), show_(show) {}

  void add(Verdict verdict, double busy_s, const std::string& station) {
    const std::lock_guard lock(mutex_);
    ++(verdict == Verdict::Pass   ? summary_.passed
       : verdict == Verdict::Fail ? summary_.failed
                                  : summary_.invalid);
    summary_.busy_s += busy_s;
    show_(static_cast<double>(summary_.checks()) / checks_,
          fmt::format("{} of {} checks, {}", summary_.checks(), checks_, station));
  }
  void tell(const std::string& words) {
    const std::lock_guard lock(mutex_);
    show_(static_cast<double>(summary_.checks()) / checks_, words);
  }
  Summary summary() const { return summary_; }

 private:
  const int checks_;
  const std::function<void(double, const std::string&)>& show_;
  std::mutex mutex_;
  Summary summary_;
};

Result<CheckRecord> check(const bench::PreparedStation& prepared, const PlannedCheck& planned) {
  bench::EmbeddedStation station(prepared, planned.brake);
  Result<CheckRecord> record = station.run_check(planned.request, nullptr, nullptr);
  if (!record) return record;
  // The factory has a calendar of its own, so that a month takes minutes and the same seed gives the same
  // records.
  const std::int64_t took_ns =
      parse_utc(record->stopped).value_or(0) - parse_utc(record->started).value_or(0);
  record->id = planned.id;
  record->started = format_utc(planned.started_utc_ns);
  record->stopped = format_utc(planned.started_utc_ns + took_ns);
  return record;
}

/// Until the database has acknowledged all that was saved.
Result<void> await_publication(const std::string& station, const bench::Publishing& publishing,
                               const CheckStore& store, publish::WakeEvent& wake, Progress& progress) {
  using namespace std::chrono_literals;
  while (true) {
    const Result<OutboxState> outbox = store.outbox(kChannel);
    if (!outbox) return tl::unexpected(outbox.error());
    if (outbox->pending == 0) return {};
    const std::vector<bench::ChannelReport> reports = publishing.report(store);
    const std::string error = reports.empty() ? "" : reports.front().error;
    if (wake.stopped())
      return failure(fmt::format("{}: ended while {} checks wait for the database{}{}", station,
                                 outbox->pending, error.empty() ? "" : ": ", error));
    progress.tell(error.empty()
                      ? fmt::format("{}: {} checks on their way to the database", station, outbox->pending)
                      : error);
    wake.wait(20ms);
  }
}

Result<void> run_station(const std::string& folder, int number, const std::vector<PlannedCheck>& checks,
                         publish::WakeEvent& wake, Progress& progress) {
  using Clock = std::chrono::steady_clock;
  const std::string name = station_name(number);
  const Result<StationConfiguration> configuration =
      read_station_configuration(path_in(folder, name + ".toml"));
  if (!configuration) return tl::unexpected(configuration.error());
  const Result<bench::PreparedStation> prepared = bench::prepare_station(*configuration);
  if (!prepared) return tl::unexpected(prepared.error());
  Result<CheckStore> store = CheckStore::open(configuration->database);
  if (!store) return tl::unexpected(store.error());
  store->queue_for(bench::publication_channels(*configuration));
  bench::Publishing publishing(*configuration, [](const std::string&, const std::string&) {});
  for (const PlannedCheck& planned : checks) {
    if (planned.station != number) continue;
    if (wake.stopped()) return failure(fmt::format("{}: ended before its last check", name));
    const Clock::time_point begin = Clock::now();
    const Result<CheckRecord> record = check(*prepared, planned);
    if (!record) return failure(fmt::format("{}: {}", name, record.error().message));
    if (const Result<void> saved = store->save(*record); !saved) return saved;
    publishing.notify();
    progress.add(record->verdict, std::chrono::duration<double>(Clock::now() - begin).count(), name);
  }
  return await_publication(name, publishing, *store, wake, progress);
}

}  // namespace

Result<void> open_archive(const Archive& archive, const publish::WakeEvent& wake) {
  publish::PostgresqlSettings settings;
  settings.host = archive.host;
  settings.port = archive.port;
  settings.database = archive.database;
  settings.user = archive.user;
  return publish::make_postgresql_channel(settings)->connect({}, wake);
}

Result<void> furnish(const std::string& folder, const Settings& settings, const Archive& archive) {
  std::error_code error;
  if (fs::create_directories(folder, error); error)
    return failure(fmt::format("{}: cannot be made: {}", folder, error.message()));
  const std::string file = path_in(folder, kSettings);
  if (fs::exists(file, error))
    return failure(
        fmt::format("{}: there is a factory in this folder already: name another one, or remove it", folder));
  for (int station = 0; station < settings.stations; ++station) {
    const std::string name = station_name(station);
    if (const Result<void> written = write_file_atomically(path_in(folder, name + ".toml"),
                                                           configuration_text(name, settings, archive));
        !written)
      return written;
  }
  if (const Result<void> written = write_file_atomically(path_in(folder, "archive.toml"),
                                                         configuration_text("archive", settings, archive));
      !written)
    return written;
  const ordered_json document{{"schema", kSchema},         {"stations", settings.stations},
                              {"checks", settings.checks}, {"days", settings.days},
                              {"seed", settings.seed},     {"repeats", settings.repeats}};
  return write_file_atomically(file, document.dump(2) + "\n");
}

Result<Settings> settings_of(const std::string& folder) {
  const std::string file = path_in(folder, kSettings);
  const Result<std::string> text = read_file(file);
  if (!text)
    return failure(text.error().message +
                   ": there is no factory in this folder; `tools/dev factory` makes one");
  try {
    const ordered_json document = ordered_json::parse(*text);
    if (document.at("schema") != kSchema)
      return failure(fmt::format("{}: is of another version, which may hide other things", file));
    return Settings{document.at("stations"), document.at("checks"), document.at("days"), document.at("seed"),
                    document.at("repeats")};
  } catch (const nlohmann::json::exception& damage) {
    return failure(fmt::format("{}: is damaged ({}): make the factory anew", file, damage.what()));
  }
}

Result<Summary> run_stations(const std::string& folder, const Settings& settings, publish::WakeEvent& wake,
                             const std::function<void(double, const std::string&)>& show) {
  const Result<sim::PlantConfiguration> shipped = bench::load_plant("");
  if (!shipped) return tl::unexpected(shipped.error());
  const std::vector<PlannedCheck> checks = plan(settings, hide(settings), *shipped);
  Progress progress(settings.checks, show);
  std::mutex mutex;
  std::optional<Error> first_error;
  for_each_index_while(
      static_cast<std::size_t>(settings.stations), ThreadBudget(threads_or_all(0)), [&](std::size_t station) {
        const Result<void> ran = run_station(folder, static_cast<int>(station), checks, wake, progress);
        const std::lock_guard lock(mutex);
        if (!ran && !first_error) first_error = ran.error();
        return ran.has_value();
      });
  if (first_error) return tl::unexpected(*first_error);
  return progress.summary();
}

}  // namespace clampd::factory
