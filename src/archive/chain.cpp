#include "src/archive/chain.hpp"

#include <array>
#include <bit>

#include "clampd/record/checksum.hpp"

namespace clampd {
namespace {

struct DigestedTable {
  const char* name;
  const char* columns;
  const char* condition;
};

/// What format 1 has of `checks`. A later version that adds columns adds a format: what was sealed stays
/// verifiable.
constexpr const char* kFirstColumns =
    "id, serial, part_number, batch, station, fixture, operator, software_version, limits_file, "
    "limits_revision, "
    "limits_sha256, trajectory_sha256, instruments, simulated, started, stopped, duration_s, repeats, "
    "verdict, "
    "marginal, reason, fault, covariance_normalised, noise_force_N, noise_velocity_rad_s, tracking_rms_N, "
    "ticks, "
    "skipped, lost_samples, lateness_min_us, lateness_avg_us, lateness_max_us, bus_load, method, "
    "noise_torque_Nm, "
    "cause, torque_while_off, tare_force_N, tare_force_sd_N, tare_velocity_rad_s, tare_velocity_sd_rad_s";

/// What later formats added to `checks`, one each: format 2 has the first of them.
constexpr std::array<const char*, kChainFormat - 1> kLaterColumns{"systematic", "stopping", "sheet", "recipe",
                                                                  "found_rad"};

constexpr std::array<DigestedTable, 4> kTables{{
    {"parameters", "position, name, unit, value, sd, lower, upper, verdict",
     "check_id = ? ORDER BY position"},
    {"runs",
     "position, name, sha256, tracking_rms_N, tracking_max_N, fit_force_rms_N, fit_velocity_rms_rad_s, "
     "estimate, "
     "converged",
     "check_id = ? ORDER BY position"},
    {"lateness_histogram", "bin_us, ticks", "check_id = ? ORDER BY bin_us"},
    {"flight_recorder",
     "position, sample_index, brake_time_ns, host_time_ns, torque_Nm, velocity_rad_s, force_N, position_rad, "
     "torque_command_Nm, force_reference_N, lateness_ns, trajectory_index, repeat, state, phase, fault",
     "check_id = ? ORDER BY position"},
}};

/// Type, value and end of a column, so that no two rows read the same.
void append_value(std::string& text, const SQLite::Column& column) {
  switch (column.getType()) {
    case SQLITE_INTEGER:
      text += fmt::format("i{};", column.getInt64());
      return;
    case SQLITE_FLOAT:
      text += fmt::format("r{:016x};", std::bit_cast<std::uint64_t>(column.getDouble()));
      return;
    case SQLITE_NULL:
      text += "n;";
      return;
    default:
      const std::string bytes = column.getString();
      text += fmt::format("t{}:{};", bytes.size(), bytes);
  }
}

/// How many rows there were.
int append_rows(std::string& text, SQLite::Statement& statement) {
  int rows = 0;
  for (; statement.executeStep(); ++rows) {
    for (int i = 0; i < statement.getColumnCount(); ++i) append_value(text, statement.getColumn(i));
    text += '\n';
  }
  statement.reset();
  return rows;
}

}  // namespace

ContentDigest::ContentDigest(SQLite::Database& database)
    : amendment_(database, "SELECT id, check_id, kind, made, content FROM amendments WHERE id = ?") {
  for (std::size_t later = 0; later <= kLaterColumns.size(); ++later) {
    std::string columns = kFirstColumns, condition = "id = ?";
    for (std::size_t i = 0; i < kLaterColumns.size(); ++i)
      if (i < later)
        columns += fmt::format(", {}", kLaterColumns[i]);
      else  // A check of an older format that has what came later was changed.
        condition += fmt::format(" AND {} = ''", kLaterColumns[i]);
    checks_.emplace_back(database, fmt::format("SELECT {} FROM checks WHERE {}", columns, condition));
  }
  for (const DigestedTable& table : kTables)
    tables_.push_back(
        {table.name, SQLite::Statement(database, fmt::format("SELECT {} FROM {} WHERE {}", table.columns,
                                                             table.name, table.condition))});
}

std::optional<std::string> ContentDigest::of_check(const std::string& id, int format) {
  if (format < 1 || format > kChainFormat) return std::nullopt;
  SQLite::Statement& check = checks_[static_cast<std::size_t>(format - 1)];
  std::string text = "[checks]\n";
  check.bind(1, id);
  if (append_rows(text, check) == 0) return std::nullopt;
  for (Table& table : tables_) {
    text += fmt::format("[{}]\n", table.name);
    table.rows.bind(1, id);
    append_rows(text, table.rows);
  }
  return sha256_hex(text);
}

std::optional<std::string> ContentDigest::of_amendment(std::int64_t id) {
  std::string text = "[amendments]\n";
  amendment_.bind(1, id);
  if (append_rows(text, amendment_) == 0) return std::nullopt;
  return sha256_hex(text);
}

std::string link_sha256(const ChainLink& link, const std::string& chain_before) {
  return sha256_hex(fmt::format("{}\n{}\n{}\n{}\n{}\n{}\n", chain_before, link.position, link.check_id,
                                link.amendment ? std::to_string(*link.amendment) : "check", link.format,
                                link.content_sha256));
}

ChainLink read_link(SQLite::Statement& all_columns) {
  ChainLink link;
  link.position = all_columns.getColumn(0).getInt64();
  link.check_id = all_columns.getColumn(1).getString();
  if (!all_columns.getColumn(2).isNull()) link.amendment = all_columns.getColumn(2).getInt64();
  link.format = all_columns.getColumn(3).getInt();
  link.content_sha256 = all_columns.getColumn(4).getString();
  link.chain_sha256 = all_columns.getColumn(5).getString();
  return link;
}

Chain::Chain(SQLite::Database& database) : database_(database), digest_(database) {
  SQLite::Statement last(database, "SELECT * FROM chain ORDER BY position DESC LIMIT 1");
  if (!last.executeStep()) return;
  const ChainLink link = read_link(last);
  last_position_ = link.position;
  last_sha256_ = link.chain_sha256;
}

void Chain::append_check(const std::string& id) {
  append({.check_id = id, .amendment = {}, .content_sha256 = {}, .chain_sha256 = {}},
         digest_.of_check(id, kChainFormat));
}

void Chain::append_amendment(const std::string& check_id, std::int64_t amendment) {
  append({.check_id = check_id, .amendment = amendment, .content_sha256 = {}, .chain_sha256 = {}},
         digest_.of_amendment(amendment));
}

void Chain::append(ChainLink link, const std::optional<std::string>& content) {
  if (!content) throw sql::Damaged(fmt::format("check {} cannot be found again", link.check_id));
  link.position = last_position_ + 1;
  link.format = kChainFormat;
  link.content_sha256 = *content;
  link.chain_sha256 = link_sha256(link, last_sha256_);
  SQLite::Statement insert(database_, "INSERT INTO chain VALUES (?, ?, ?, ?, ?, ?)");
  insert.bind(1, link.position);
  insert.bind(2, link.check_id);
  if (link.amendment) insert.bind(3, *link.amendment);
  insert.bind(4, link.format);
  insert.bind(5, link.content_sha256);
  insert.bind(6, link.chain_sha256);
  insert.exec();
  last_position_ = link.position;
  last_sha256_ = link.chain_sha256;
}

Result<void> unchanged(SQLite::Database& database, const std::string& path, const std::string& id) {
  const auto changed = [&](const char* what) {
    return failure(fmt::format(
        "{}: {} {} was changed after it was recorded: its checksum does not match; `clampctl records "
        "verify` names all that are, `clampctl records restore` brings a backup back",
        path, what, id));
  };
  ContentDigest digest(database);
  SQLite::Statement links(database, "SELECT * FROM chain WHERE check_id = ? ORDER BY position");
  links.bind(1, id);
  bool sealed = false;
  std::int64_t amendments = 0;
  while (links.executeStep()) {
    const ChainLink link = read_link(links);
    if (!link.amendment) {
      sealed = true;
      if (digest.of_check(id, link.format) != link.content_sha256) return changed("check");
    } else {
      ++amendments;
      if (digest.of_amendment(*link.amendment) != link.content_sha256)
        return changed("an amendment of check");
    }
  }
  SQLite::Statement count(database, "SELECT COUNT(*) FROM amendments WHERE check_id = ?");
  count.bind(1, id);
  count.executeStep();
  if (!sealed || count.getColumn(0).getInt64() != amendments) return changed("check");
  return {};
}

}  // namespace clampd
