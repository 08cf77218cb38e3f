#pragma once

#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "clampd/archive/store.hpp"
#include "clampd/base/result.hpp"
#include "tools/control/messages.hpp"

namespace clampd::daemon {

/// What the control API may ask of the daemon; called from the server's threads.
class ControlTarget {
 public:
  virtual ~ControlTarget() = default;
  virtual control::StationStatus status() = 0;
  virtual Result<std::uint64_t> start(const CheckRequest& request) = 0;
  virtual Result<void> next(const CheckRequest& request) = 0;
  virtual control::CheckProgress progress(bool colour) = 0;
  virtual Result<void> stop() = 0;
  virtual Result<void> clear() = 0;
  virtual Result<nlohmann::ordered_json> results(const CheckFilter& filter) = 0;
  virtual Result<nlohmann::ordered_json> result(const std::string& id) = 0;
  virtual Result<nlohmann::ordered_json> run(const std::string& id, std::size_t number) = 0;
  virtual Result<nlohmann::ordered_json> statistics(std::uint32_t limit) = 0;
  virtual nlohmann::ordered_json reference() = 0;
  virtual nlohmann::ordered_json live(std::uint64_t run, std::size_t row) = 0;
};

/// The control API of tools/control/messages.hpp over HTTP, and the screen.
class ControlServer {
 public:
  /// Binds and starts to serve; or serves on `inherited`, a listening socket that is there already and stays
  /// usable for the next one who inherits it. An empty token file: no token is asked for; one with a token in
  /// it, that is ours and not readable by everybody, is used again, so that a restart locks no screen out.
  /// Errors: the address is taken or not ours, the token file cannot be written.
  static Result<std::unique_ptr<ControlServer>> start(ControlTarget& target, const std::string& address,
                                                      int port, const std::string& token_file,
                                                      int inherited = -1);
  ~ControlServer();
  ControlServer(const ControlServer&) = delete;
  ControlServer& operator=(const ControlServer&) = delete;

  int port() const { return port_; }

 private:
  struct Http;
  ControlServer();

  std::unique_ptr<Http> http_;
  std::thread thread_;
  int port_ = 0;
};

}  // namespace clampd::daemon
