#include <fcntl.h>
#include <unistd.h>

#include <filesystem>

#include <SQLiteCpp/Backup.h>

#include "clampd/record/utc.hpp"
#include "src/archive/database.hpp"

namespace clampd {
namespace {

namespace fs = std::filesystem;

constexpr int kPatience_ms = 30'000;

/// One consistent state, in one step: those who write to a write-ahead logged source go on meanwhile.
Result<void> copy(SQLite::Database& from, SQLite::Database& to, const std::string& path) {
  SQLite::Backup backup(to, from);
  const int status = backup.executeStep(-1);
  if (status == SQLITE_DONE) return {};
  return failure(
      fmt::format("{}: {}; another process is writing to it: try again", path, sqlite3_errstr(status)));
}

void sync_to_disk(const std::string& path) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return;
  ::fsync(file);
  ::close(file);
}

/// Into a file that is not there yet, and is there only once it is whole. The copy needs no write-ahead log.
Result<void> copy_to_new_file(SQLite::Database& from, const std::string& file) {
  std::error_code error;
  if (fs::exists(file, error)) return failure(fmt::format("{}: is there already; name a new file", file));
  const std::string partial = file + ".part";
  fs::remove(partial, error);
  {
    SQLite::Database to(partial, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE, kPatience_ms);
    if (Result<void> copied = copy(from, to, file); !copied) return copied;
    to.execAndGet("PRAGMA journal_mode = DELETE");
  }
  sync_to_disk(partial);
  fs::rename(partial, file, error);
  if (error) return failure(fmt::format("{}: cannot be written: {}", file, error.message()));
  sync_to_disk(fs::absolute(file).parent_path().string());
  return {};
}

/// What stands at `path` gets this name. A file that is too damaged to be copied is renamed.
Result<void> put_aside(const std::string& path, const std::string& aside) {
  try {
    SQLite::Database present(path, SQLite::OPEN_READWRITE, kPatience_ms);
    return copy_to_new_file(present, aside);
  } catch (const SQLite::Exception&) {
    std::error_code error;
    fs::remove(aside + ".part", error);
    for (const char* suffix : {"", "-wal", "-shm"})
      if (fs::exists(path + suffix, error)) fs::rename(path + suffix, aside + suffix, error);
    if (error) return failure(fmt::format("{}: cannot be put aside: {}", path, error.message()));
    return {};
  }
}

}  // namespace

Result<void> CheckStore::back_up(const std::string& file) const {
  try {
    return copy_to_new_file(database_->handle, file);
  } catch (const SQLite::Exception& exception) {
    return sql::explained(file, exception);
  }
}

Result<std::string> restore_backup(const std::string& backup, const std::string& path,
                                   std::int64_t now_utc_ns) {
  std::error_code error;
  if (fs::equivalent(backup, path, error)) return failure(fmt::format("{}: is the database itself", backup));
  const Result<Verification> verified =
      CheckStore::open(backup, CheckStore::Access::ReadOnly).and_then([](const CheckStore& store) {
        return store.verify();
      });
  if (!verified) return tl::unexpected(verified.error());
  if (!verified->damage.empty()) {
    const Verification::Damage& first = verified->damage.front();
    return failure(fmt::format("{}: is damaged in {} places, the first one: {}{}{}; nothing was changed",
                               backup, verified->damage.size(), first.check, first.check.empty() ? "" : ": ",
                               first.what));
  }
  std::string aside;
  if (fs::exists(path, error)) {
    std::string stamp = format_utc(now_utc_ns);
    std::erase_if(stamp, [](char c) { return c == ':' || c == '-' || c == '.'; });
    aside = fmt::format("{}.before-{}", path, stamp);
    if (Result<void> kept = put_aside(path, aside); !kept) return tl::unexpected(kept.error());
  }
  try {
    SQLite::Database from(backup, SQLite::OPEN_READONLY, kPatience_ms);
    SQLite::Database to(path, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE, kPatience_ms);
    if (const Result<void> copied = copy(from, to, path); !copied) return tl::unexpected(copied.error());
  } catch (const SQLite::Exception& exception) {
    return sql::explained(path, exception);
  }
  // In the state in which a station leaves it: up to date and write-ahead logged.
  return CheckStore::open(path).map([&](const CheckStore&) { return aside; });
}

}  // namespace clampd
