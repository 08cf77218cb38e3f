#include "src/archive/record_rows.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <nlohmann/json.hpp>

#include "clampd/record/checksum.hpp"
#include "clampd/archive/compression.hpp"

namespace clampd {
namespace {

using sql::Columns;
using sql::Row;

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

/// Empty if it could not be told.
std::string systematic_text(const std::optional<SystematicRecord>& systematic) {
  return systematic ? nlohmann::json{{"p_value", systematic->p_value},
                                     {"over_noise", systematic->over_noise},
                                     {"moved_sd", systematic->moved_sd},
                                     {"marked", systematic->marked}}
                          .dump()
                    : "";
}

std::optional<SystematicRecord> systematic_from(const std::string& text) {
  if (text.empty()) return std::nullopt;
  const nlohmann::json systematic = nlohmann::json::parse(text);
  return SystematicRecord{systematic.at("p_value").get<double>(), systematic.at("over_noise").get<double>(),
                          systematic.at("moved_sd").get<double>(), systematic.at("marked").get<bool>()};
}

/// Empty where the number of repeats was fixed.
std::string stopping_text(const std::optional<StoppingRecord>& stopping) {
  if (!stopping) return "";
  nlohmann::json document{{"most", stopping->most},
                          {"coverage_factor", stopping->coverage_factor},
                          {"reason", stopping->reason}};
  if (!stopping->trajectories.empty()) {
    document["trajectories"] = stopping->trajectories;
    document["followed"] = stopping->followed;
  }
  return document.dump();
}

std::optional<StoppingRecord> stopping_from(const std::string& text) {
  if (text.empty()) return std::nullopt;
  const nlohmann::json stopping = nlohmann::json::parse(text);
  return StoppingRecord{stopping.at("most").get<std::uint32_t>(),
                        stopping.at("coverage_factor").get<double>(),
                        stopping.at("reason").get<std::string>(),
                        stopping.value("trajectories", std::vector<std::string>()),
                        stopping.value("followed", std::vector<std::uint8_t>())};
}

/// Empty where the station had no sheet. What is not known and limits that are not there are left out: JSON
/// has no NaN and no infinity.
std::string sheet_text(const std::optional<SheetRecord>& sheet) {
  if (!sheet) return "";
  nlohmann::json lines = nlohmann::json::array();
  for (const CharacteristicRecord& c : sheet->characteristics) {
    nlohmann::json line{{"name", c.name}, {"kind", c.kind}, {"unit", c.unit}};
    for (const auto& [key, value] :
         {std::pair{"value", c.value}, {"sd", c.sd}, {"lower", c.lower}, {"upper", c.upper}})
      if (std::isfinite(value)) line[key] = value;
    if (c.verdict) line["verdict"] = static_cast<int>(*c.verdict);
    if (!c.why.empty()) line["why"] = c.why;
    if (!c.circumstances.empty()) line["circumstances"] = c.circumstances;
    lines.push_back(std::move(line));
  }
  return nlohmann::json{{"file", sheet->file},
                        {"revision", sheet->revision},
                        {"sha256", sheet->sha256},
                        {"misfit_marked", sheet->misfit_marked},
                        {"characteristics", std::move(lines)}}
      .dump();
}

std::optional<SheetRecord> sheet_from(const std::string& text) {
  if (text.empty()) return std::nullopt;
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  constexpr double kNoLimit = std::numeric_limits<double>::infinity();
  const nlohmann::json sheet = nlohmann::json::parse(text);
  SheetRecord record{sheet.at("file").get<std::string>(),
                     sheet.at("revision").get<std::string>(),
                     sheet.at("sha256").get<std::string>(),
                     sheet.at("misfit_marked").get<bool>(),
                     {}};
  for (const nlohmann::json& line : sheet.at("characteristics")) {
    CharacteristicRecord c{line.at("name").get<std::string>(),
                           line.at("kind").get<std::string>(),
                           line.at("unit").get<std::string>(),
                           line.value("value", kNaN),
                           line.value("sd", kNaN),
                           line.value("lower", -kNoLimit),
                           line.value("upper", kNoLimit)};
    if (const int verdict = line.value("verdict", -1);
        verdict >= 0 && verdict <= static_cast<int>(ParameterVerdict::Fail))
      c.verdict = static_cast<ParameterVerdict>(verdict);
    c.why = line.value("why", "");
    c.circumstances = line.value("circumstances", "");
    record.characteristics.push_back(std::move(c));
  }
  return record;
}

/// Empty where the station had no recipes.
std::string recipe_text(const std::optional<RecipeRecord>& recipe) {
  return recipe ? nlohmann::json{{"file", recipe->file}, {"version", recipe->version}, {"sha256", recipe->sha256}}
                      .dump()
                : "";
}

std::optional<RecipeRecord> recipe_from(const std::string& text) {
  if (text.empty()) return std::nullopt;
  const nlohmann::json recipe = nlohmann::json::parse(text);
  return RecipeRecord{recipe.at("file").get<std::string>(), recipe.at("version").get<std::string>(),
                      recipe.at("sha256").get<std::string>()};
}

/// Empty where it is not known.
std::string found_text(const std::optional<double>& found_rad) {
  return found_rad ? nlohmann::json(*found_rad).dump() : "";
}

std::optional<double> found_from(const std::string& text) {
  return text.empty() ? std::optional<double>() : nlohmann::json::parse(text).get<double>();
}

constexpr int kCheckColumns = 46;
/// Microseconds; the loop keeps a few thousand.
constexpr std::size_t kMaxHistogramBins = 1'000'000;

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
      << r.tare_force_N << r.tare_force_sd_N << r.tare_velocity_rad_s << r.tare_velocity_sd_rad_s
      << systematic_text(r.systematic) << stopping_text(r.stopping) << sheet_text(r.sheet)
      << recipe_text(r.recipe) << found_text(r.found_rad);
  row.insert();
}

void insert_details(SQLite::Database& database, const CheckRecord& r) {
  Row parameters(database, "parameters", 9);
  for (std::size_t i = 0; i < r.parameters.size(); ++i) {
    const ParameterRecord& p = r.parameters[i];
    parameters << r.id << i << p.name << p.unit << p.value << p.sd << p.lower << p.upper
               << static_cast<int>(p.verdict);
    parameters.insert();
  }
  Row runs(database, "runs", 14);
  for (std::size_t i = 0; i < r.runs.size(); ++i) {
    const RunRecord& run = r.runs[i];
    const std::string csv = format_run(run.run);
    const sql::Blob data{compressed(csv)};
    runs << r.id << i << run.run.name << std::string() << sha256_hex(csv) << run.tracking_rms_N
         << run.tracking_max_N << run.fit_force_rms_N << run.fit_velocity_rms_rad_s
         << numbers_text(run.estimate) << run.converged << data.bytes.size() << std::string() << data;
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
  const Result<std::string> csv = read_run_text(columns);
  if (!csv) return failure(fmt::format("{}: {} of check {}: {}", path, name, id, csv.error().message));
  if (sha256_hex(*csv) != record.checksum_sha256)
    return failure(fmt::format(
        "{}: {} of check {} was changed after it was recorded: its checksum does not match", path, name, id));
  Result<LoadedRun> loaded = parse_run(*csv, name);
  if (!loaded) return failure(fmt::format("{}: check {}: {}", path, id, loaded.error().message));
  record.run = std::move(loaded->run);
  return record;
}

void read_histogram(SQLite::Database& database, const std::string& id, TimingRecord& timing) {
  SQLite::Statement histogram(
      database, "SELECT bin_us, ticks FROM lateness_histogram WHERE check_id = ? ORDER BY bin_us");
  histogram.bind(1, id);
  while (histogram.executeStep()) {
    std::size_t bin = 0;
    std::uint64_t ticks = 0;
    Columns(histogram) >> bin >> ticks;
    if (bin >= kMaxHistogramBins || bin < timing.lateness_histogram.size())
      throw sql::Damaged(fmt::format("lateness_histogram.bin_us is {}, which clampd never writes", bin));
    timing.lateness_histogram.resize(bin + 1);
    timing.lateness_histogram[bin] = ticks;
  }
}

void read_flight_recorder(SQLite::Database& database, CheckRecord& r) {
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
}

}  // namespace

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

void insert_record(SQLite::Database& database, const CheckRecord& record) {
  insert_check(database, record);
  insert_details(database, record);
}

void read_check(SQLite::Statement& statement, CheckRecord& r) {
  std::string covariance, cause, torque_while_off, systematic, stopping, sheet, recipe, found;
  Columns columns(statement);
  columns >> r.id >> r.serial >> r.part_number >> r.batch >> r.station >> r.fixture >> r.operator_name >>
      r.software_version >> r.limits_file >> r.limits_revision >> r.limits_sha256 >> r.trajectory_sha256 >>
      r.instruments >> r.simulated >> r.started >> r.stopped >> r.duration_s >> r.repeats >> r.verdict >>
      r.marginal >> r.reason >> r.fault >> covariance >> r.noise_force_N >> r.noise_velocity_rad_s >>
      r.tracking_rms_N >> r.timing.ticks >> r.timing.skipped >> r.timing.lost_samples >>
      r.timing.lateness_min_us >> r.timing.lateness_avg_us >> r.timing.lateness_max_us >> r.timing.bus_load >>
      r.method >> r.noise_torque_Nm >> cause >> torque_while_off >> r.tare_force_N >> r.tare_force_sd_N >>
      r.tare_velocity_rad_s >> r.tare_velocity_sd_rad_s >> systematic >> stopping >> sheet >> recipe >> found;
  r.found_rad = found_from(found);
  r.recipe = recipe_from(recipe);
  r.sheet = sheet_from(sheet);
  r.stopping = stopping_from(stopping);
  r.systematic = systematic_from(systematic);
  r.cause = cause_from(cause);
  r.torque_while_off = torque_while_off_from(torque_while_off);
  r.covariance_normalised = numbers_from(covariance);
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

/// Of the runs, by what the record says of its stopping.
void tell_trajectories(CheckRecord& r) {
  if (!r.stopping) return;
  for (std::size_t i = 0; i < std::min(r.runs.size(), r.stopping->followed.size()); ++i)
    r.runs[i].trajectory = r.stopping->followed[i];
}

void read_run_figures(SQLite::Database& database, CheckRecord& r) {
  SQLite::Statement runs(
      database, fmt::format("SELECT {} FROM runs WHERE check_id = ? ORDER BY position", kRunFigures));
  runs.bind(1, r.id);
  while (runs.executeStep()) {
    Columns columns(runs);
    r.runs.push_back(read_run_figures(columns));
  }
  tell_trajectories(r);
}

Result<std::string> read_run_text(Columns& columns) {
  sql::Blob plain, data;
  columns >> plain >> data;
  return data.bytes.empty() ? Result<std::string>(std::move(plain.bytes)) : decompressed(data.bytes);
}

Result<void> read_details(SQLite::Database& database, const std::string& path, CheckRecord& r) {
  read_parameters(database, r);
  SQLite::Statement runs(
      database,
      fmt::format("SELECT {}, csv, data FROM runs WHERE check_id = ? ORDER BY position", kRunFigures));
  runs.bind(1, r.id);
  while (runs.executeStep()) {
    Result<RunRecord> run = read_run(runs, path, r.id);
    if (!run) return tl::unexpected(run.error());
    r.runs.push_back(std::move(*run));
  }
  tell_trajectories(r);
  read_histogram(database, r.id, r.timing);
  read_flight_recorder(database, r);
  return {};
}

}  // namespace clampd
