#pragma once

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <stdexcept>

namespace clampd::support {

/// Of the loopback interface; port 0: any.
inline sockaddr_in loopback(int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

/// As systemd hands it over: a socket that listens on a port of the loopback interface, which is put in
/// `port`.
inline int listening_socket(int& port) {
  const int listening = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address = loopback(0);
  socklen_t length = sizeof address;
  if (::bind(listening, reinterpret_cast<sockaddr*>(&address), length) != 0 || ::listen(listening, 8) != 0 ||
      ::getsockname(listening, reinterpret_cast<sockaddr*>(&address), &length) != 0)
    throw std::runtime_error("no socket to listen on");
  port = ntohs(address.sin_port);
  return listening;
}

/// A TCP port of the loopback interface that nothing used a moment ago: below those that the kernel gives to
/// clients, which might take it before a station is back on it, and never the same one twice in a program.
inline int free_port() {
  constexpr int kFirst = 20000;
  constexpr int kCount = 12000;
  static std::atomic<int> next{static_cast<int>(::getpid() % 150) * 80};
  for (int tried = 0; tried < kCount; ++tried) {
    const int port = kFirst + next++ % kCount;
    const int descriptor = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const sockaddr_in address = loopback(port);
    const bool free = ::bind(descriptor, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
    ::close(descriptor);
    if (free) return port;
  }
  throw std::runtime_error("no free port");
}

}  // namespace clampd::support
