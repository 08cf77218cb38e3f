#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "clampd/api/messages.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/base/result.hpp"
#include "clampd/http/screen.hpp"
#include "clampd/station/configuration.hpp"
#include "rt/control_core.hpp"

namespace clampd::http {
class Server;
}

namespace clampd::api {

/// What the control API may ask of the daemon. stop() is called from the thread that serves all connections,
/// so it must not wait for anything: no lock, no file. The others are called from worker threads: one for
/// commands, one for what the station does now, two for the archive.
class ControlTarget {
 public:
  virtual ~ControlTarget() = default;
  virtual StationStatus status() = 0;
  /// The station as Prometheus scrapes it: station_metrics().
  virtual std::string metrics() = 0;
  /// Taken when a request to start something arrives, before anything is waited for; takes no lock.
  virtual rt::StartTicket ticket() const = 0;
  /// `stops_seen`: StationStatus::stops as whoever asks has seen it; refused if it is another by now.
  virtual Result<StartedCheck> start(const CheckRequest& request, const rt::StartTicket& ticket,
                                              std::optional<std::uint64_t> stops_seen) = 0;
  /// Opens a brake that stays clamped: the opening's id, which the status follows.
  virtual Result<std::string> open(const rt::StartTicket& ticket, std::optional<std::uint64_t> stops_seen) = 0;
  virtual Result<void> next(const CheckRequest& request) = 0;
  virtual CheckProgress progress(bool colour) = 0;
  /// Waits for nothing and takes no lock.
  virtual Result<void> stop() = 0;
  virtual Result<void> clear() = 0;
  virtual Result<nlohmann::ordered_json> results(const CheckFilter& filter) = 0;
  virtual Result<nlohmann::ordered_json> result(const std::string& id) = 0;
  virtual Result<nlohmann::ordered_json> run(const std::string& id, std::size_t number) = 0;
  virtual Result<nlohmann::ordered_json> statistics(const CheckFilter& filter) = 0;
  virtual nlohmann::ordered_json reference() = 0;
  virtual nlohmann::ordered_json live(std::uint64_t run, std::size_t row) = 0;
};

/// The control API (docs/api.md) and the screen, over HTTP.
class ControlServer {
 public:
  /// Binds and starts to serve the API and the files of `screen`, which must outlive this; or serves on `inherited`, a listening socket that is there already and stays
  /// usable for the next one who inherits it. Without a token file no token is asked for.
  /// Errors: the address is taken or not ours, the token file cannot be written.
  static Result<std::unique_ptr<ControlServer>> start(ControlTarget& target, const ControlSettings& settings,
                                                      std::span<const http::ScreenFile> screen, int inherited = -1);
  ~ControlServer();
  ControlServer(const ControlServer&) = delete;
  ControlServer& operator=(const ControlServer&) = delete;

  int port() const;

 private:
  class Api;
  ControlServer(std::unique_ptr<Api> api, std::unique_ptr<http::Server> server);

  std::unique_ptr<Api> api_;
  std::unique_ptr<http::Server> server_;
};

}  // namespace clampd::api
