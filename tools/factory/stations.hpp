#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "clampd/base/result.hpp"
#include "clampd/publish/wake_event.hpp"
#include "tools/factory/plan.hpp"

namespace clampd::factory {

/// The line's database, as [postgresql] names it.
struct Archive {
  std::string host;  ///< name, address, or folder of the server's socket
  int port = 5432;
  std::string database = "clampd";
  std::string user;  ///< empty: as the operating system calls it
};

/// What the stations' checks came to.
struct Summary {
  int passed = 0;
  int failed = 0;
  int invalid = 0;      ///< no verdict about the brake
  double busy_s = 0.0;  ///< with checks, of all threads together

  int checks() const { return passed + failed + invalid; }
};

/// Makes the database's schema, once, before the stations come all at the same time. Errors: it cannot be
/// reached, or may not be changed.
Result<void> open_archive(const Archive& archive, const publish::WakeEvent& wake);

/// Writes into the folder, which is made if need be, what each station needs: station-1.toml, ... and
/// archive.toml, for whoever works with the database only. What is hidden follows from the settings and
/// stands nowhere. Errors: there is a factory in this folder already, or it cannot be written.
Result<void> furnish(const std::string& folder, const Settings& settings, const Archive& archive);

/// What furnish() was told. Errors: there is no factory in this folder.
Result<Settings> settings_of(const std::string& folder);

/// Runs all checks in virtual time, on as many threads as there are processors, each station with its own
/// store, and returns once the database has acknowledged them all. `progress` is called by any thread; `wake`
/// ends the work at the next check. Errors: a configuration or store cannot be used, or it was ended.
Result<Summary> run_stations(const std::string& folder, const Settings& settings, publish::WakeEvent& wake,
                             const std::function<void(double share, const std::string& words)>& progress);

}  // namespace clampd::factory
