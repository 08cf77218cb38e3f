#pragma once

#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include "support/network.hpp"

namespace clampd::support {

/// A TCP connection to a port of the loopback interface, byte by byte: for what no proper client would send.
class Connection {
 public:
  explicit Connection(int port) : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    const sockaddr_in address = loopback(port);
    if (socket_ < 0 || TEMP_FAILURE_RETRY(::connect(socket_, reinterpret_cast<const sockaddr*>(&address),
                                                    sizeof address)) != 0)
      throw std::runtime_error("cannot connect to port " + std::to_string(port));
  }
  ~Connection() {
    if (socket_ >= 0) ::close(socket_);
  }
  Connection(Connection&& other) noexcept : socket_(std::exchange(other.socket_, -1)) {}
  Connection& operator=(Connection&&) = delete;
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// As much as the other end takes; false if it has closed.
  bool send(std::string_view bytes) const {
    while (!bytes.empty()) {
      const ssize_t count = TEMP_FAILURE_RETRY(::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL));
      if (count <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(count));
    }
    return true;
  }
  /// There is no more to say.
  void finish() const { ::shutdown(socket_, SHUT_WR); }

  /// What comes until the other end closes. `drip`: sent every 50 ms until then.
  std::string receive(std::string_view drip = "") const {
    std::string received;
    std::array<char, 4096> buffer{};
    while (true) {
      pollfd waiting{socket_, POLLIN, 0};
      if (!drip.empty() && ::poll(&waiting, 1, 50) == 0) {
        ::send(socket_, drip.data(), drip.size(), MSG_NOSIGNAL);
        continue;
      }
      const ssize_t count = TEMP_FAILURE_RETRY(::recv(socket_, buffer.data(), buffer.size(), 0));
      if (count <= 0) return received;
      received.append(buffer.data(), static_cast<std::size_t>(count));
    }
  }

  /// How little of an answer waits in the kernel for who does not read it.
  void take_little() const {
    const int bytes = 1;
    ::setsockopt(socket_, SOL_SOCKET, SO_RCVBUF, &bytes, sizeof bytes);
  }

 private:
  int socket_;
};

/// What comes back for these very bytes.
inline std::string answer_to(int port, std::string_view bytes) {
  const Connection connection(port);
  connection.send(bytes);
  return connection.receive();
}

/// So that a test can have as many connections as it is about.
inline void allow_open_files(rlim_t count) {
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  if (limit.rlim_max < count) throw std::runtime_error("this user may not have so many files open");
  if (limit.rlim_cur >= count) return;
  limit.rlim_cur = count;
  ::setrlimit(RLIMIT_NOFILE, &limit);
}

}  // namespace clampd::support
