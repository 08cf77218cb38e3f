#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>

#include "clampd/base/result.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/publish/wake_event.hpp"
#include "clampd/reanalysis/line_archive.hpp"

namespace clampd::worker {

/// Documents of the page of the line. Each is kept for half a minute, what attribution found for five, and an
/// error for five seconds, so that any number of screens that show the same cost the database and this
/// machine one reading. get() is used by one thread.
class LineDocuments {
 public:
  LineDocuments(std::string worker, publish::PostgresqlSettings database)
      : worker_(std::move(worker)), database_(std::move(database)) {}

  /// clampd.line_page/1 as text. Errors are those of reanalysis::read_line().
  Result<std::string> get(const reanalysis::LineQuestion& question);
  /// Nothing waits for a connection any more; from any thread.
  void stop() noexcept { wake_.stop(); }

 private:
  using Clock = std::chrono::steady_clock;
  using Key = std::pair<int, std::optional<std::string>>;  ///< days and part number
  struct Kept {
    Result<std::string> text = failure("not read");
    Clock::time_point until;
    nlohmann::ordered_json attribution;
    Clock::time_point attribution_until;
  };
  Kept& kept(const Key& key);

  const std::string worker_;
  const publish::PostgresqlSettings database_;
  publish::WakeEvent wake_;
  std::map<Key, Kept> kept_;
};

}  // namespace clampd::worker
