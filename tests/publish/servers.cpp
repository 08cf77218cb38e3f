#include "publish/servers.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <pwd.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>

#include <fmt/format.h>
#include <pqxx/pqxx>

#ifdef __SANITIZE_ADDRESS__
// libpqxx 6.4 loses the result of a query during which the connection breaks: two kilobytes an outage.
extern "C" const char* __lsan_default_suppressions();
extern "C" const char* __lsan_default_suppressions() {
  return "leak:PQmakeEmptyPGresult\n";
}
#endif

namespace clampd::support {
namespace {

namespace fs = std::filesystem;

/// Whom a server may run as: PostgreSQL refuses root.
const passwd* unprivileged() {
  return ::geteuid() == 0 ? ::getpwnam("nobody") : nullptr;
}

std::string program(const std::string& name) {
  for (const char* folder :
       {"/usr/sbin", "/usr/bin", "/usr/local/sbin", "/usr/local/bin", "/usr/lib/postgresql/15/bin"})
    if (::access((fs::path(folder) / name).c_str(), X_OK) == 0) return fs::path(folder) / name;
  return "";
}

std::string content_of(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

int status_of(const std::vector<std::string>& arguments, const std::string& log);

pid_t spawn(const std::vector<std::string>& arguments, const std::string& log) {
  std::vector<char*> argv;
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  const int output = ::open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  const passwd* user = unprivileged();
  const pid_t parent = ::getpid();
  const pid_t child = ::fork();
  if (child != 0) {
    ::close(output);
    return child;
  }
  if (user != nullptr && (::setgid(user->pw_gid) != 0 || ::setuid(user->pw_uid) != 0)) ::_exit(126);
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(126);
  ::dup2(output, 1);
  ::dup2(output, 2);
  // Out of reach of a keyboard's Ctrl-C: the test ends its servers in its own order.
  ::setpgid(0, 0);
  if (::chdir("/") != 0) ::_exit(126);
  ::execv(argv[0], argv.data());
  ::_exit(127);
}

int status_of(const std::vector<std::string>& arguments, const std::string& log) {
  int status = -1;
  ::waitpid(spawn(arguments, log), &status, 0);
  return status;
}

bool listens(int port) {
  const int descriptor = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const sockaddr_in address = loopback(port);
  const bool connected =
      ::connect(descriptor, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  ::close(descriptor);
  return connected;
}

}  // namespace

void give_to_server(const std::string& path) {
  if (const passwd* user = unprivileged();
      user != nullptr && ::chown(path.c_str(), user->pw_uid, user->pw_gid) != 0)
    throw std::runtime_error("cannot give away " + path);
}

void ServerProcess::start(const std::vector<std::string>& arguments, const std::string& log) {
  process_ = spawn(arguments, log);
  if (process_ < 0) throw std::runtime_error("cannot start " + arguments[0]);
}

void ServerProcess::signal(int signal) const {
  if (process_ > 0) ::kill(process_, signal);
}

int ServerProcess::end(int signal) {
  if (process_ <= 0) return 0;
  ::kill(process_, signal);
  int status = 0;
  ::waitpid(process_, &status, 0);
  process_ = -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

std::string Broker::missing() {
  return program("mosquitto").empty() ? "no mosquitto here: `tools/dev setup` installs it" : "";
}

Broker::Broker(std::string settings) : settings_(std::move(settings)), port_(free_port()) {
  give_to_server(folder_.path("."));
}

void Broker::start() {
  const std::string configuration =
      folder_.write("mosquitto.conf",
                    fmt::format("listener {} 127.0.0.1\nallow_anonymous true\npersistence true\n"
                                "persistence_location {}/\nmax_queued_messages 0\nset_tcp_nodelay true\n{}",
                                port_, folder_.path("."), settings_));
  process_.start({program("mosquitto"), "-c", configuration}, folder_.path("mosquitto.log"));
  if (!eventually([&] { return listens(port_); })) throw std::runtime_error("no broker: " + log());
}

void Broker::stop() {
  process_.end(SIGTERM);
}

std::string Database::missing() {
  return program("initdb").empty() ? "no PostgreSQL 15 here: `tools/dev setup` installs it" : "";
}

Database::Database() {
  give_to_server(folder_.path("."));
  fs::create_directory(folder_.path("socket"));
  give_to_server(folder_.path("socket"));
  const std::string log = folder_.path("initdb.log");
  if (status_of({program("initdb"), "-D", folder_.path("data"), "-U", "line", "-A", "trust", "-E", "UTF8",
                 "--locale=C", "--no-sync"},
                log) != 0)
    throw std::runtime_error("initdb: " + content_of(log));
  start();
  pqxx::connection server("host=" + host() + " dbname=postgres user=line");
  pqxx::nontransaction(server).exec("CREATE DATABASE line");
}

publish::PostgresqlSettings Database::settings() const {
  publish::PostgresqlSettings settings;
  settings.host = host();
  settings.database = settings.user = "line";
  return settings;
}

std::string Database::section(const std::string& host) {
  return fmt::format("[postgresql]\nhost = \"{}\"\ndatabase = \"line\"\nuser = \"line\"\n", host);
}

void Database::start() {
  process_.start({program("postgres"), "-D", folder_.path("data"), "-c", "listen_addresses=", "-c",
                  "unix_socket_directories=" + host(), "-c", "fsync=off", "-c", "shared_buffers=8MB"},
                 folder_.path("postgres.log"));
  if (!eventually([&] { return answers(); }))
    throw std::runtime_error("no PostgreSQL: " + folder_.read("postgres.log"));
}

bool Database::answers() const {
  try {
    pqxx::connection server("host=" + host() + " dbname=postgres user=line");
    return server.is_open();
  } catch (const std::exception&) {
    return false;
  }
}

void Database::stop() {
  process_.end(SIGINT);
}

void Database::crash() {
  process_.end(SIGQUIT);
}

std::string Database::ask(const std::string& sql) const {
  const std::vector<std::string> values = column(sql);
  return values.empty() ? "" : values.front();
}

std::vector<std::string> Database::column(const std::string& sql) const {
  pqxx::connection server(connection());
  pqxx::nontransaction transaction(server);
  std::vector<std::string> values;
  for (const auto& row : transaction.exec(sql)) values.emplace_back(row[0].c_str());
  return values;
}

}  // namespace clampd::support
