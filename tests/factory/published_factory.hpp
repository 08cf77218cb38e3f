#pragma once

#include <stdexcept>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "publish/servers.hpp"
#include "support/command.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::factory {

/// The checks of a factory in a database of their own, and jobs that do all of them anew.
class PublishedFactory {
 public:
  /// Programs as CMake names them. Throws what the factory said if it failed.
  explicit PublishedFactory(int checks, int repeats = 3) : checks_(checks) {
    run(
        fmt::format("{} --folder {} --host {} --database line --user line --stations 4 --checks {} --repeats "
                    "{} --seed 11",
                    CLAMPD_FACTORY, folder_.path("factory"), server.host(), checks, repeats));
    configuration_ = configuration_for("worker.toml", server.host());
    // Workers run as another user where the test is root.
    support::give_to_server(folder_.path("."));
  }

  /// One undisturbed worker does all of it.
  void make_reference() {
    submit();
    finish(1);
    reference_ = digest();
  }

  int checks() const { return checks_; }
  std::string path(const std::string& name) const { return folder_.path(name); }
  std::string read(const std::string& name) const { return folder_.read(name); }
  /// What a worker needs, through a socket in this folder.
  std::string configuration_for(const std::string& name, const std::string& host) const {
    return folder_.write(name, support::Database::section(host));
  }

  /// A job of all checks, of which nothing is known yet.
  void submit() const {
    server.ask("DELETE FROM clampd.queue");
    server.ask("DELETE FROM clampd.jobs");
    server.ask("DELETE FROM clampd.results");
    archive("submit" + options_);
  }
  /// What jobs ask beside identification, from now on.
  void ask(const std::string& options) { options_ = " " + options; }
  void archive(const std::string& words) const {
    run(fmt::format("{} --config {} archive {}", CLAMPCTL, configuration_, words));
  }
  std::vector<std::string> worker(const std::string& name, int lease_s) const {
    return worker(name, lease_s, configuration_);
  }
  static std::vector<std::string> worker(const std::string& name, int lease_s,
                                         const std::string& configuration) {
    return {CLAMPD_WORKER, "--config", configuration, "--name", name, "--lease", std::to_string(lease_s)};
  }
  /// This many undisturbed workers, until nothing is left.
  void finish(int workers) const {
    std::string line;
    for (int number = 1; number <= workers; ++number)
      line += fmt::format("{} --config {} --until-empty --name finishing-{} & ", CLAMPD_WORKER,
                          configuration_, number);
    run(line + "wait");
  }
  std::string count(const std::string& state) const {
    return server.ask("SELECT count(*) FROM clampd.queue WHERE state = '" + state + "'");
  }
  /// What digest() was then.
  const std::string& reference() const { return reference_; }
  /// SHA-256 over all results, in the order of their checks.
  std::string digest() const {
    return server.ask(
        "SELECT encode(sha256(convert_to(string_agg(check_id || document, '' ORDER BY check_id), 'UTF8')), "
        "'hex') FROM clampd.results");
  }

  support::Database server;

 private:
  static void run(const std::string& line) {
    const support::Outcome outcome = support::run_command(line);
    if (outcome.exit_code != 0) throw std::runtime_error(line + ": " + outcome.output);
  }

  int checks_;
  support::TemporaryDirectory folder_;
  std::string configuration_;
  std::string options_;
  std::string reference_;
};

}  // namespace clampd::factory
