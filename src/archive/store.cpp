#include "clampd/archive/store.hpp"

#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <optional>
#include <regex>
#include <utility>

#include <nlohmann/json.hpp>

#include "clampd/record/checksum.hpp"
#include "src/archive/database.hpp"

namespace clampd {
namespace {

using sql::Columns;
using sql::explained;
using sql::Row;

/// Step i brings a database of version i to i + 1 (PRAGMA user_version). Steps are never changed, only added.
constexpr std::array<const char*, 6> kMigrations{R"sql(
CREATE TABLE checks (
  id TEXT PRIMARY KEY NOT NULL,
  serial TEXT NOT NULL, part_number TEXT NOT NULL, batch TEXT NOT NULL,
  station TEXT NOT NULL, fixture TEXT NOT NULL, operator TEXT NOT NULL, software_version TEXT NOT NULL,
  limits_file TEXT NOT NULL, limits_revision TEXT NOT NULL, limits_sha256 TEXT NOT NULL,
  trajectory_sha256 TEXT NOT NULL, instruments TEXT NOT NULL, simulated INTEGER NOT NULL,
  started TEXT NOT NULL, stopped TEXT NOT NULL, duration_s REAL, repeats INTEGER NOT NULL,
  verdict INTEGER NOT NULL, marginal INTEGER NOT NULL, reason TEXT NOT NULL, fault INTEGER NOT NULL,
  covariance_normalised TEXT NOT NULL, noise_force_N REAL, noise_velocity_rad_s REAL, tracking_rms_N REAL,
  ticks INTEGER NOT NULL, skipped INTEGER NOT NULL, lost_samples INTEGER NOT NULL,
  lateness_min_us REAL, lateness_avg_us REAL, lateness_max_us REAL, bus_load REAL) STRICT;
CREATE INDEX checks_by_serial ON checks (serial, started);
CREATE INDEX checks_by_time ON checks (started);
CREATE TABLE parameters (
  check_id TEXT NOT NULL REFERENCES checks (id), position INTEGER NOT NULL,
  name TEXT NOT NULL, unit TEXT NOT NULL, value REAL, sd REAL, lower REAL, upper REAL, verdict INTEGER NOT NULL,
  PRIMARY KEY (check_id, position)) STRICT;
CREATE TABLE runs (
  check_id TEXT NOT NULL REFERENCES checks (id), position INTEGER NOT NULL,
  name TEXT NOT NULL, csv TEXT NOT NULL, sha256 TEXT NOT NULL, tracking_rms_N REAL, tracking_max_N REAL,
  fit_force_rms_N REAL, fit_velocity_rms_rad_s REAL, estimate TEXT NOT NULL, converged INTEGER NOT NULL,
  PRIMARY KEY (check_id, position)) STRICT;
CREATE TABLE lateness_histogram (
  check_id TEXT NOT NULL REFERENCES checks (id), bin_us INTEGER NOT NULL, ticks INTEGER NOT NULL,
  PRIMARY KEY (check_id, bin_us)) STRICT;
CREATE TABLE flight_recorder (
  check_id TEXT NOT NULL REFERENCES checks (id), position INTEGER NOT NULL,
  sample_index INTEGER NOT NULL, brake_time_ns INTEGER NOT NULL, host_time_ns INTEGER NOT NULL,
  torque_Nm REAL, velocity_rad_s REAL, force_N REAL, position_rad REAL, torque_command_Nm REAL,
  force_reference_N REAL, lateness_ns INTEGER NOT NULL, trajectory_index INTEGER NOT NULL, repeat INTEGER NOT NULL,
  state INTEGER NOT NULL, phase INTEGER NOT NULL, fault INTEGER NOT NULL,
  PRIMARY KEY (check_id, position)) STRICT;
)sql",
                                                 R"sql(
ALTER TABLE checks ADD COLUMN method TEXT NOT NULL DEFAULT 'oem';
ALTER TABLE checks ADD COLUMN noise_torque_Nm REAL;
)sql",
                                                 R"sql(
ALTER TABLE checks ADD COLUMN cause TEXT NOT NULL DEFAULT '';
)sql",
                                                 R"sql(
CREATE INDEX checks_by_part ON checks (part_number, started);
CREATE INDEX checks_by_batch ON checks (batch, started);
CREATE INDEX checks_by_operator ON checks (operator, started);
CREATE TABLE limits_revisions (
  sha256 TEXT PRIMARY KEY NOT NULL, revision TEXT NOT NULL, author TEXT NOT NULL, changed TEXT NOT NULL,
  file TEXT NOT NULL, contents TEXT NOT NULL, first_used TEXT NOT NULL) STRICT;
CREATE TABLE publication (
  check_id TEXT NOT NULL REFERENCES checks (id), channel TEXT NOT NULL, state INTEGER NOT NULL,
  PRIMARY KEY (check_id, channel)) STRICT;
CREATE INDEX publication_pending ON publication (channel, check_id) WHERE state = 0;
ALTER TABLE runs ADD COLUMN bytes INTEGER NOT NULL DEFAULT 0;
ALTER TABLE runs ADD COLUMN removed TEXT NOT NULL DEFAULT '';
UPDATE runs SET bytes = length(csv);
CREATE INDEX runs_kept ON runs (check_id, bytes) WHERE removed = '';
)sql",
                                                 R"sql(
ALTER TABLE publication ADD COLUMN sequence INTEGER NOT NULL DEFAULT 0;
ALTER TABLE publication ADD COLUMN queued TEXT NOT NULL DEFAULT '';
UPDATE publication SET sequence = (SELECT COUNT(*) FROM publication p
  WHERE p.channel = publication.channel AND p.check_id <= publication.check_id);
CREATE UNIQUE INDEX publication_order ON publication (channel, sequence);
DROP INDEX publication_pending;
CREATE INDEX publication_next ON publication (channel, sequence) WHERE state = 0;
CREATE TABLE outbox_connections (channel TEXT PRIMARY KEY NOT NULL, connections INTEGER NOT NULL) STRICT;
)sql",
                                                 R"sql(
ALTER TABLE checks ADD COLUMN torque_while_off TEXT NOT NULL DEFAULT '';
ALTER TABLE checks ADD COLUMN tare_force_N REAL NOT NULL DEFAULT 0;
ALTER TABLE checks ADD COLUMN tare_force_sd_N REAL NOT NULL DEFAULT 0;
ALTER TABLE checks ADD COLUMN tare_velocity_rad_s REAL NOT NULL DEFAULT 0;
ALTER TABLE checks ADD COLUMN tare_velocity_sd_rad_s REAL NOT NULL DEFAULT 0;
)sql"};

std::string numbers_text(const std::vector<double>& values) {
  nlohmann::json array = nlohmann::json::array();
  for (const double value : values)
    array.push_back(std::isfinite(value) ? nlohmann::json(value) : nlohmann::json());
  return array.dump();
}

std::vector<double> numbers_from(const std::string& text) {
  std::vector<double> values;
  for (const auto& value : nlohmann::json::parse(text))
    values.push_back(value.is_null() ? std::numeric_limits<double>::quiet_NaN() : value.get<double>());
  return values;
}

/// Empty if there is none.
std::string cause_text(const std::optional<CauseRecord>& cause) {
  if (!cause) return "";
  return nlohmann::json{{"verdict", cause->verdict},
                        {"effects", cause->effects},
                        {"location", cause->location},
                        {"rivals", cause->rivals},
                        {"summary", cause->summary}}
      .dump();
}

std::optional<CauseRecord> cause_from(const std::string& text) {
  if (text.empty()) return std::nullopt;
  const nlohmann::json cause = nlohmann::json::parse(text);
  CauseRecord record;
  cause.at("verdict").get_to(record.verdict);
  cause.at("effects").get_to(record.effects);
  cause.at("location").get_to(record.location);
  cause.at("rivals").get_to(record.rivals);
  cause.at("summary").get_to(record.summary);
  return record;
}

/// Empty if it is not known.
std::string torque_while_off_text(const std::optional<TorqueWhileOff>& torque) {
  return torque ? nlohmann::json{torque->mean_Nm, torque->sd_Nm, torque->rows}.dump() : "";
}

std::optional<TorqueWhileOff> torque_while_off_from(const std::string& text) {
  if (text.empty()) return std::nullopt;
  const nlohmann::json torque = nlohmann::json::parse(text);
  return TorqueWhileOff{torque.at(0).get<double>(), torque.at(1).get<double>(),
                        torque.at(2).get<std::size_t>()};
}

void migrate(SQLite::Database& database, int version) {
  for (std::size_t step = static_cast<std::size_t>(version); step < kMigrations.size(); ++step) {
    SQLite::Transaction transaction(database, SQLite::TransactionBehavior::IMMEDIATE);
    // Another process may have been faster while this one waited for the lock.
    if (database.execAndGet("PRAGMA user_version").getInt() > static_cast<int>(step)) continue;
    database.exec(kMigrations[step]);
    database.exec(fmt::format("PRAGMA user_version = {}", step + 1));
    transaction.commit();
  }
}

constexpr int kCheckColumns = 41;

void insert_check(SQLite::Database& database, const CheckRecord& r) {
  Row row(database, "checks", kCheckColumns);
  row << r.id << r.serial << r.part_number << r.batch << r.station << r.fixture << r.operator_name
      << r.software_version << r.limits_file << r.limits_revision << r.limits_sha256 << r.trajectory_sha256
      << r.instruments << r.simulated << r.started << r.stopped << r.duration_s << r.repeats
      << static_cast<int>(r.verdict) << r.marginal << r.reason << static_cast<int>(r.fault)
      << numbers_text(r.covariance_normalised) << r.noise_force_N << r.noise_velocity_rad_s
      << r.tracking_rms_N << r.timing.ticks << r.timing.skipped << r.timing.lost_samples
      << r.timing.lateness_min_us << r.timing.lateness_avg_us << r.timing.lateness_max_us << r.timing.bus_load
      << r.method << r.noise_torque_Nm << cause_text(r.cause) << torque_while_off_text(r.torque_while_off)
      << r.tare_force_N << r.tare_force_sd_N << r.tare_velocity_rad_s << r.tare_velocity_sd_rad_s;
  row.insert();
}

void read_check(SQLite::Statement& statement, CheckRecord& r) {
  std::string covariance, cause, torque_while_off;
  Columns columns(statement);
  columns >> r.id >> r.serial >> r.part_number >> r.batch >> r.station >> r.fixture >> r.operator_name >>
      r.software_version >> r.limits_file >> r.limits_revision >> r.limits_sha256 >> r.trajectory_sha256 >>
      r.instruments >> r.simulated >> r.started >> r.stopped >> r.duration_s >> r.repeats >> r.verdict >>
      r.marginal >> r.reason >> r.fault >> covariance >> r.noise_force_N >> r.noise_velocity_rad_s >>
      r.tracking_rms_N >> r.timing.ticks >> r.timing.skipped >> r.timing.lost_samples >>
      r.timing.lateness_min_us >> r.timing.lateness_avg_us >> r.timing.lateness_max_us >> r.timing.bus_load >>
      r.method >> r.noise_torque_Nm >> cause >> torque_while_off >> r.tare_force_N >> r.tare_force_sd_N >>
      r.tare_velocity_rad_s >> r.tare_velocity_sd_rad_s;
  r.cause = cause_from(cause);
  r.torque_while_off = torque_while_off_from(torque_while_off);
  r.covariance_normalised = numbers_from(covariance);
}

void insert_details(SQLite::Database& database, const CheckRecord& r) {
  Row parameters(database, "parameters", 9);
  for (std::size_t i = 0; i < r.parameters.size(); ++i) {
    const ParameterRecord& p = r.parameters[i];
    parameters << r.id << i << p.name << p.unit << p.value << p.sd << p.lower << p.upper
               << static_cast<int>(p.verdict);
    parameters.insert();
  }
  Row runs(database, "runs", 13);
  for (std::size_t i = 0; i < r.runs.size(); ++i) {
    const RunRecord& run = r.runs[i];
    const std::string csv = format_run(run.run);
    runs << r.id << i << run.run.name << csv << sha256_hex(csv) << run.tracking_rms_N << run.tracking_max_N
         << run.fit_force_rms_N << run.fit_velocity_rms_rad_s << numbers_text(run.estimate) << run.converged
         << csv.size() << std::string();
    runs.insert();
  }
  Row histogram(database, "lateness_histogram", 3);
  const auto& bins = r.timing.lateness_histogram;
  for (std::size_t i = 0; i < bins.size(); ++i) {
    if (bins[i] == 0 && i + 1 < bins.size()) continue;  // the last bin is kept for the number of bins
    histogram << r.id << i << bins[i];
    histogram.insert();
  }
  Row samples(database, "flight_recorder", 17);
  for (std::size_t i = 0; i < r.flight_recorder.size(); ++i) {
    const Sample& s = r.flight_recorder[i];
    samples << r.id << i << s.sample_index << s.brake_time_ns << s.host_time_ns << s.torque_Nm
            << s.velocity_rad_s << s.force_N << s.position_rad << s.torque_command_Nm << s.force_reference_N
            << s.lateness_ns << s.trajectory_index << s.repeat << static_cast<int>(s.state)
            << static_cast<int>(s.phase) << static_cast<int>(s.fault);
    samples.insert();
  }
}

/// All of a run but its rows.
constexpr const char* kRunFigures =
    "name, sha256, tracking_rms_N, tracking_max_N, fit_force_rms_N, fit_velocity_rms_rad_s, estimate, "
    "converged, removed";

RunRecord read_run_figures(Columns& columns) {
  RunRecord record;
  std::string estimate;
  columns >> record.run.name >> record.checksum_sha256 >> record.tracking_rms_N >> record.tracking_max_N >>
      record.fit_force_rms_N >> record.fit_velocity_rms_rad_s >> estimate >> record.converged >>
      record.removed;
  record.estimate = numbers_from(estimate);
  return record;
}

Result<RunRecord> read_run(SQLite::Statement& statement, const std::string& path, const std::string& id) {
  Columns columns(statement);
  RunRecord record = read_run_figures(columns);
  if (!record.removed.empty()) return record;
  const std::string name = record.run.name;
  std::string csv;
  columns >> csv;
  if (sha256_hex(csv) != record.checksum_sha256)
    return failure(fmt::format(
        "{}: {} of check {} was changed after it was recorded: its checksum does not match", path, name, id));
  Result<LoadedRun> loaded = parse_run(csv, name);
  if (!loaded) return failure(fmt::format("{}: check {}: {}", path, id, loaded.error().message));
  record.run = std::move(loaded->run);
  return record;
}

void read_parameters(SQLite::Database& database, CheckRecord& r) {
  SQLite::Statement parameters(
      database,
      "SELECT name, unit, value, sd, lower, upper, verdict FROM parameters WHERE check_id = ? "
      "ORDER BY position");
  parameters.bind(1, r.id);
  while (parameters.executeStep()) {
    ParameterRecord p;
    Columns(parameters) >> p.name >> p.unit >> p.value >> p.sd >> p.lower >> p.upper >> p.verdict;
    r.parameters.push_back(std::move(p));
  }
}

Result<void> read_details(SQLite::Database& database, const std::string& path, CheckRecord& r) {
  read_parameters(database, r);
  SQLite::Statement runs(
      database, fmt::format("SELECT {}, csv FROM runs WHERE check_id = ? ORDER BY position", kRunFigures));
  runs.bind(1, r.id);
  while (runs.executeStep()) {
    Result<RunRecord> run = read_run(runs, path, r.id);
    if (!run) return tl::unexpected(run.error());
    r.runs.push_back(std::move(*run));
  }
  SQLite::Statement histogram(
      database, "SELECT bin_us, ticks FROM lateness_histogram WHERE check_id = ? ORDER BY bin_us");
  histogram.bind(1, r.id);
  while (histogram.executeStep()) {
    std::size_t bin = 0;
    std::uint64_t ticks = 0;
    Columns(histogram) >> bin >> ticks;
    r.timing.lateness_histogram.resize(bin + 1);
    r.timing.lateness_histogram[bin] = ticks;
  }
  SQLite::Statement samples(
      database,
      "SELECT sample_index, brake_time_ns, host_time_ns, torque_Nm, velocity_rad_s, force_N, position_rad, "
      "torque_command_Nm, force_reference_N, lateness_ns, trajectory_index, repeat, state, phase, fault "
      "FROM flight_recorder WHERE check_id = ? ORDER BY position");
  samples.bind(1, r.id);
  while (samples.executeStep()) {
    Sample s;
    Columns(samples) >> s.sample_index >> s.brake_time_ns >> s.host_time_ns >> s.torque_Nm >>
        s.velocity_rad_s >> s.force_N >> s.position_rad >> s.torque_command_Nm >> s.force_reference_N >>
        s.lateness_ns >> s.trajectory_index >> s.repeat >> s.state >> s.phase >> s.fault;
    r.flight_recorder.push_back(s);
  }
  return {};
}

/// "2026-11-21T10:00Z" as a prefix of stored times, which are all in UTC.
std::string without_zone(std::string time) {
  if (!time.empty() && time.back() == 'Z') time.pop_back();
  return time;
}

/// Conditions only for what is asked, so that the indices serve. Newest first is the order of saving: the
/// clock may have been set back in between.
SQLite::Statement select_checks(SQLite::Database& database, std::string_view columns,
                                const CheckFilter& filter) {
  std::vector<std::string> conditions;
  std::vector<std::string> texts;
  const auto where = [&](const char* condition, const std::string& value) {
    if (value.empty()) return;
    conditions.emplace_back(condition);
    texts.push_back(value);
  };
  where("serial = ?", filter.serial);
  where("part_number = ?", filter.part_number);
  where("batch = ?", filter.batch);
  where("operator = ?", filter.operator_name);
  where("started >= ?", without_zone(filter.since));
  // A bound of less than full precision includes all that begins with it.
  where("started <= ? || '~'", without_zone(filter.until));
  if (filter.verdict) conditions.push_back(fmt::format("verdict = {}", static_cast<int>(*filter.verdict)));
  SQLite::Statement statement(database, fmt::format("SELECT {} FROM checks {}{} ORDER BY rowid DESC LIMIT {}",
                                                    columns, conditions.empty() ? "" : "WHERE ",
                                                    fmt::join(conditions, " AND "), filter.limit));
  for (std::size_t i = 0; i < texts.size(); ++i) statement.bind(static_cast<int>(i + 1), texts[i]);
  return statement;
}

/// The text with LIKE's own characters taken literally, by ESCAPE '\'.
std::string like_prefix(const std::string& text) {
  std::string pattern;
  for (const char c : text) {
    if (c == '%' || c == '_' || c == '\\') pattern += '\\';
    pattern += c;
  }
  return pattern + '%';
}

}  // namespace

bool is_filter_time(const std::string& text) {
  static const std::regex kPattern(R"(\d{4}-\d\d-\d\d(T\d\d:\d\d(:\d\d(\.\d{1,9})?)?Z?)?)");
  return text.size() <= 40 && std::regex_match(text, kPattern);
}

CheckStore::CheckStore(std::unique_ptr<Database> database) : database_(std::move(database)) {}
CheckStore::CheckStore(CheckStore&&) noexcept = default;
CheckStore& CheckStore::operator=(CheckStore&&) noexcept = default;
CheckStore::~CheckStore() = default;

Result<CheckStore> CheckStore::open(const std::string& path, Access access, int busy_timeout_ms) {
  namespace fs = std::filesystem;
  std::error_code error;
  const bool writing = access == Access::ReadWrite;
  if (fs::is_directory(path, error))
    return failure(fmt::format("{}: is a directory, not a database of results", path));
  if (!writing && !fs::exists(path, error))
    return failure(fmt::format("{}: there is no such database of results: no check was saved yet", path));
  if (writing && fs::path(path).has_parent_path()) {
    fs::create_directories(fs::path(path).parent_path(), error);
    if (error) return failure(fmt::format("{}: cannot make its folder: {}", path, error.message()));
  }
  try {
    auto database = std::make_unique<Database>(Database{
        path,
        SQLite::Database(path, writing ? SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE : SQLite::OPEN_READONLY,
                         busy_timeout_ms)});
    SQLite::Database& handle = database->handle;
    const int version = handle.execAndGet("PRAGMA user_version").getInt();
    if (version > static_cast<int>(kMigrations.size()))
      return failure(
          fmt::format("{}: was written by a newer version of clampd (schema {}, this one knows {})", path,
                      version, kMigrations.size()));
    if (writing && sqlite3_db_readonly(handle.getHandle(), "main") != 0)
      return failure(
          fmt::format("{}: may only be read, and every check has to be saved: check who owns it and "
                      "whether its disk is mounted read-only",
                      path));
    if (writing) {
      handle.exec("PRAGMA journal_mode = WAL");
      handle.exec("PRAGMA synchronous = FULL");
      handle.exec("PRAGMA foreign_keys = ON");
      migrate(handle, version);
    } else if (version < static_cast<int>(kMigrations.size())) {
      return failure(
          fmt::format("{}: holds no results of this version (schema {} instead of {}); a check brings it up "
                      "to date",
                      path, version, kMigrations.size()));
    }
    return CheckStore(std::move(database));
  } catch (const SQLite::Exception& exception) {
    return explained(path, exception);
  }
}

Result<void> CheckStore::save(const CheckRecord& record) {
  SQLite::Database& handle = database_->handle;
  try {
    SQLite::Transaction transaction(handle, SQLite::TransactionBehavior::IMMEDIATE);
    insert_check(handle, record);
    insert_details(handle, record);
    for (const std::string& channel : outbox_channels_)
      sql::put_into_outbox(handle, record.id, channel, PublicationState::Pending);
    transaction.commit();
    return {};
  } catch (const SQLite::Exception& exception) {
    if (exception.getErrorCode() == SQLITE_CONSTRAINT)
      return failure(
          fmt::format("{}: check {} is already there: {}", database_->path, record.id, exception.what()));
    return explained(database_->path, exception);
  }
}

Result<std::vector<CheckSummary>> CheckStore::list(const CheckFilter& filter) const {
  try {
    SQLite::Statement statement = select_checks(
        database_->handle, "id, serial, started, verdict, marginal, simulated, repeats, duration_s, reason",
        filter);
    std::vector<CheckSummary> checks;
    while (statement.executeStep()) {
      CheckSummary check;
      Columns(statement) >> check.id >> check.serial >> check.started >> check.verdict >> check.marginal >>
          check.simulated >> check.repeats >> check.duration_s >> check.reason;
      checks.push_back(std::move(check));
    }
    return checks;
  } catch (const SQLite::Exception& exception) {
    return explained(database_->path, exception);
  }
}

Result<std::vector<CheckRecord>> CheckStore::load_results(const CheckFilter& filter) const {
  try {
    SQLite::Statement statement = select_checks(database_->handle, "*", filter);
    std::vector<CheckRecord> checks;
    while (statement.executeStep()) {
      CheckRecord& check = checks.emplace_back();
      read_check(statement, check);
      read_parameters(database_->handle, check);
    }
    return checks;
  } catch (const SQLite::Exception& exception) {
    return explained(database_->path, exception);
  } catch (const nlohmann::json::exception& exception) {
    return failure(fmt::format("{}: a check is damaged: {}", database_->path, exception.what()));
  }
}

Result<CheckRecord> CheckStore::load_result(const std::string& id) const {
  const std::string& path = database_->path;
  try {
    SQLite::Statement statement(database_->handle, "SELECT * FROM checks WHERE id = ?");
    statement.bind(1, id);
    if (!statement.executeStep()) return failure(fmt::format("{}: no check {}", path, id));
    CheckRecord record;
    read_check(statement, record);
    read_parameters(database_->handle, record);
    SQLite::Statement runs(
        database_->handle,
        fmt::format("SELECT {} FROM runs WHERE check_id = ? ORDER BY position", kRunFigures));
    runs.bind(1, id);
    while (runs.executeStep()) {
      Columns columns(runs);
      record.runs.push_back(read_run_figures(columns));
    }
    return record;
  } catch (const SQLite::Exception& exception) {
    return explained(path, exception);
  } catch (const nlohmann::json::exception& exception) {
    return failure(fmt::format("{}: check {} is damaged: {}", path, id, exception.what()));
  }
}

Result<CheckRecord> CheckStore::load(const std::string& id) const {
  const std::string& path = database_->path;
  try {
    SQLite::Statement statement(
        database_->handle, id == "last"
                               ? "SELECT * FROM checks ORDER BY rowid DESC LIMIT 1"
                               : R"(SELECT * FROM checks WHERE id LIKE ? ESCAPE '\' ORDER BY id LIMIT 2)");
    if (id != "last") statement.bind(1, like_prefix(id));
    if (!statement.executeStep())
      return failure(fmt::format("{}: no check {}; `clampctl results` lists them", path, id));
    CheckRecord record;
    read_check(statement, record);
    if (id != "last" && record.id != id && statement.executeStep())
      return failure(fmt::format("{}: {} stands for more than one check: give more of its id", path, id));
    if (Result<void> details = read_details(database_->handle, path, record); !details)
      return tl::unexpected(details.error());
    return record;
  } catch (const SQLite::Exception& exception) {
    return explained(path, exception);
  } catch (const nlohmann::json::exception& exception) {
    return failure(fmt::format("{}: check {} is damaged: {}", path, id, exception.what()));
  }
}

}  // namespace clampd
