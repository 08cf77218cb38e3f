#pragma once

#include <optional>
#include <string>

#include "clampd/api/messages.hpp"
#include "dashboard/program.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::faults {

/// A daemon on its simulated brake, in a folder that outlives it. Its checks wait for a broker that is not
/// there.
class Station {
 public:
  /// `more`: what else its configuration says.
  explicit Station(const std::string& more = "");

  /// Starts the program and waits until it answers: its first status.
  api::StationStatus start();
  /// Waits until a check may begin; false if that does not come.
  bool wait_for_idle() const;
  /// Waits for a finished check: its document.
  nlohmann::ordered_json finished() const;
  /// Sends the signal and waits for the end: its exit code, -signal if it was killed.
  int end(int signal);

  const api::Client& client() const { return client_; }
  int port() const { return port_; }
  /// The control API's; empty before the daemon has made it.
  std::string token() const { return folder_.read("token").substr(0, 64); }
  std::string database() const { return folder_.path("state/checks.sqlite"); }
  const support::TemporaryDirectory& folder() const { return folder_; }
  std::string log() const { return folder_.read("log"); }
  pid_t process() const { return program_->process(); }

 private:
  support::TemporaryDirectory folder_;
  int port_;
  std::string configuration_;
  api::Client client_;
  std::optional<screen::Program> program_;
};

}  // namespace clampd::faults
