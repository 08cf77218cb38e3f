#include "src/publish/reachable.hpp"

#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <memory>

#include <fmt/format.h>

namespace clampd::publish {
namespace {

class Socket {
 public:
  explicit Socket(const addrinfo& address)
      : descriptor_(::socket(address.ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0)) {}
  ~Socket() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;
  int descriptor() const { return descriptor_; }

 private:
  int descriptor_;
};

/// 0, or an errno.
int try_address(const addrinfo& address, const WakeEvent& wake, std::chrono::milliseconds longest) {
  const Socket socket(address);
  if (socket.descriptor() < 0) return errno;
  if (::connect(socket.descriptor(), address.ai_addr, address.ai_addrlen) == 0) return 0;
  if (errno != EINPROGRESS) return errno;
  constexpr std::chrono::milliseconds kSlice(100);
  for (auto waited = std::chrono::milliseconds(0); waited < longest && !wake.stopped(); waited += kSlice) {
    pollfd writable{socket.descriptor(), POLLOUT, 0};
    if (::poll(&writable, 1, static_cast<int>(kSlice.count())) <= 0) continue;
    int error = 0;
    socklen_t size = sizeof error;
    return ::getsockopt(socket.descriptor(), SOL_SOCKET, SO_ERROR, &error, &size) == 0 ? error : errno;
  }
  return ETIMEDOUT;
}

}  // namespace

Result<void> reachable(const std::string& host, int port, const WakeEvent& wake,
                       std::chrono::milliseconds longest) {
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int unknown = ::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found);
      unknown != 0)
    return failure(fmt::format("the name {} is not known ({}): is the network there, is the host right?",
                               host, ::gai_strerror(unknown)));
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> addresses(found, &::freeaddrinfo);
  int error = 0;
  for (const addrinfo* address = found; address != nullptr && !wake.stopped(); address = address->ai_next) {
    error = try_address(*address, wake, longest);
    if (error == 0) return {};
  }
  if (error == ECONNREFUSED)
    return failure(
        fmt::format("nothing listens at {}:{}: is the service running, is the port right?", host, port));
  return failure(fmt::format("{}:{} does not answer ({}): is the network there, is the machine on?", host,
                             port, std::strerror(error)));
}

}  // namespace clampd::publish
