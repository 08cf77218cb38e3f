#include "clampd/daemon/service_manager.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <cstring>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"

namespace clampd::daemon {

namespace {

std::int64_t watchdog_timeout_ns() {
  std::uint64_t timeout_us = 0;
  if (sd_watchdog_enabled(0, &timeout_us) <= 0) return 0;
  return static_cast<std::int64_t>(timeout_us) * 1000;
}

/// Address and port as "127.0.0.1:8371", "[::1]:8371".
std::string text_of(const sockaddr_storage& address) {
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (address.ss_family == AF_INET) {
    sockaddr_in v4{};
    std::memcpy(&v4, &address, sizeof v4);
    inet_ntop(AF_INET, &v4.sin_addr, text.data(), text.size());
    return fmt::format("{}:{}", text.data(), ntohs(v4.sin_port));
  }
  sockaddr_in6 v6{};
  std::memcpy(&v6, &address, sizeof v6);
  inet_ntop(AF_INET6, &v6.sin6_addr, text.data(), text.size());
  return fmt::format("[{}]:{}", text.data(), ntohs(v6.sin6_port));
}

}  // namespace

bool WatchdogFeed::due(std::uint64_t ticks, std::int64_t now_ns) noexcept {
  if (period_ns_ <= 0 || ticks == fed_ticks_) return false;
  if (fed_ticks_ != 0 && now_ns - fed_ns_ < period_ns_) return false;
  fed_ticks_ = ticks;
  fed_ns_ = now_ns;
  return true;
}

ServiceManager::ServiceManager() : feed_(watchdog_timeout_ns()) {}

Result<int> ServiceManager::inherited_socket(const std::string& address, int port) {
  const int count = sd_listen_fds(0);
  if (count <= 0) return -1;
  if (count > 1)
    return failure(fmt::format("clampd.socket hands over {} sockets: leave one ListenStream in it", count));
  const int socket = SD_LISTEN_FDS_START;
  sockaddr_storage bound{};
  socklen_t length = sizeof bound;
  if (sd_is_socket(socket, AF_UNSPEC, SOCK_STREAM, 1) <= 0 ||
      getsockname(socket, reinterpret_cast<sockaddr*>(&bound), &length) != 0 ||
      (bound.ss_family != AF_INET && bound.ss_family != AF_INET6))
    return failure(
        "clampd.socket hands over something else than a listening TCP socket: see its ListenStream");
  const bool v6 = address.find(':') != std::string::npos;
  const std::string wanted = v6 ? fmt::format("[{}]:{}", address, port) : fmt::format("{}:{}", address, port);
  if (text_of(bound) != wanted)
    return failure(fmt::format(
        "clampd.socket listens on {}, but [control] in the configuration says {}, where clients look "
        "for it: make them the same (`systemctl edit clampd.socket`, with an empty ListenStream= "
        "before the new one)",
        text_of(bound), wanted));
  return socket;
}

void ServiceManager::round(std::uint64_t ticks, const std::string& headline, std::int64_t now_ns) {
  if (!ready_ && ticks > 0) {
    ready_ = true;
    sd_notify(0, "READY=1");
  }
  if (headline != headline_) {
    headline_ = headline;
    sd_notify(0, ("STATUS=" + headline).c_str());
  }
  if (stopping_ || feed_.due(ticks, now_ns)) sd_notify(0, "WATCHDOG=1");
}

void ServiceManager::stopping() {
  if (stopping_) return;
  stopping_ = true;
  sd_notify(0, "STOPPING=1");
}

bool logs_to_journal() {
  const char* stream = std::getenv("JOURNAL_STREAM");
  struct stat found {};
  if (stream == nullptr || fstat(STDERR_FILENO, &found) != 0) return false;
  return fmt::format("{}:{}", found.st_dev, found.st_ino) == stream;
}

}  // namespace clampd::daemon
