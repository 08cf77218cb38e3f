#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "clampd/publish/channel.hpp"
#include "support/eventually.hpp"
#include "support/network.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::support {

/// A program of its own, as an unprivileged user where the test is root; killed with its test at the latest.
class ServerProcess {
 public:
  ~ServerProcess() { end(9); }
  /// Standard output and error go to `log`.
  void start(const std::vector<std::string>& arguments, const std::string& log);
  /// Sends the signal and waits until the process is gone. Returns its exit code, or the number of the signal
  /// that ended it, negative; 0 if it was not started.
  int end(int signal);
  /// Sends it, and does not wait.
  void signal(int signal) const;
  bool running() const { return process_ > 0; }

 private:
  pid_t process_ = -1;
};

/// Gives a file or folder to the user whom ServerProcess runs as.
void give_to_server(const std::string& path);

/// mosquitto with persistent sessions, on a port that stays the same from start to start.
class Broker {
 public:
  static std::string missing();  ///< why there can be none; empty: there can

  /// `settings`: further lines of its configuration.
  explicit Broker(std::string settings = "");
  void start();
  /// SIGTERM: it writes down what it has acknowledged.
  void stop();
  void kill() { process_.end(9); }
  int port() const { return port_; }
  std::string path(const std::string& name) const { return folder_.path(name); }
  std::string log() const { return folder_.read("mosquitto.log"); }

 private:
  TemporaryDirectory folder_;
  std::string settings_;
  int port_;
  ServerProcess process_;
};

/// PostgreSQL on a socket in a folder of its own, database and superuser "line".
class Database {
 public:
  static std::string missing();

  Database();
  void start();
  void stop();
  /// As a power cut does: recovery at the next start.
  void crash();
  std::string host() const { return folder_.path("socket"); }
  /// As a station or worker has them.
  publish::PostgresqlSettings settings() const;
  /// The same as a section of a configuration, through a socket in this folder.
  static std::string section(const std::string& host);
  std::string connection() const { return "host=" + host() + " dbname=line user=line connect_timeout=5"; }
  /// First field of the first row, as text.
  std::string ask(const std::string& sql) const;
  std::vector<std::string> column(const std::string& sql) const;

 private:
  bool answers() const;
  TemporaryDirectory folder_;
  ServerProcess process_;
};

}  // namespace clampd::support
