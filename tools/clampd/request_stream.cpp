#include "tools/clampd/request_stream.hpp"

#include <arpa/inet.h>
#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>

namespace clampd::daemon {

namespace {

constexpr std::chrono::milliseconds kLongestWrite{5000};
constexpr std::chrono::milliseconds kLongestDrain{500};
constexpr std::size_t kMostDrained = 4 * 1024 * 1024;

template <class Ask>
void address_of(socket_t socket, std::string& ip, int& port, Ask ask) {
  sockaddr_storage address{};
  socklen_t length = sizeof address;
  std::array<char, NI_MAXHOST> host{};
  std::array<char, NI_MAXSERV> service{};
  auto* generic = reinterpret_cast<sockaddr*>(&address);
  if (ask(socket, generic, &length) != 0) return;
  if (getnameinfo(generic, length, host.data(), host.size(), service.data(), service.size(),
                  NI_NUMERICHOST | NI_NUMERICSERV) != 0)
    return;
  ip = host.data();
  port = std::atoi(service.data());
}

}  // namespace

RequestStream::RequestStream(socket_t socket, std::chrono::milliseconds whole_request, std::size_t largest,
                             const std::atomic<bool>& stopping)
    : socket_(socket), deadline_(Clock::now() + whole_request), allowance_(largest), stopping_(stopping) {}

bool RequestStream::wait_for(short events, Clock::time_point until) const {
  constexpr int kLookAround_ms = 50;  // how soon a daemon that ends is noticed
  while (!stopping_ && Clock::now() < until) {
    pollfd waiting{socket_, events, 0};
    const int ready = poll(&waiting, 1, kLookAround_ms);
    if (ready > 0) return true;
    if (ready < 0 && errno != EINTR) return false;
  }
  return false;
}

bool RequestStream::is_readable() const {
  return begin_ < end_ || wait_for(POLLIN, deadline_);
}

bool RequestStream::is_writable() const {
  return wait_for(POLLOUT, Clock::now() + kLongestWrite);
}

ssize_t RequestStream::read(char* out, size_t size) {
  if (begin_ == end_) {
    if (allowance_ == 0 || !wait_for(POLLIN, deadline_)) return -1;
    const ssize_t received = recv(socket_, buffer_.data(), std::min(buffer_.size(), allowance_), 0);
    if (received <= 0) return received;
    begin_ = 0;
    end_ = static_cast<std::size_t>(received);
    allowance_ -= end_;
  }
  const std::size_t taken = std::min(size, end_ - begin_);
  std::copy_n(buffer_.data() + begin_, taken, out);
  begin_ += taken;
  return static_cast<ssize_t>(taken);
}

ssize_t RequestStream::write(const char* data, size_t size) {
  if (!is_writable()) return -1;
  return send(socket_, data, size, MSG_NOSIGNAL | MSG_DONTWAIT);
}

void RequestStream::get_remote_ip_and_port(std::string& ip, int& port) const {
  address_of(socket_, ip, port, getpeername);
}

void RequestStream::get_local_ip_and_port(std::string& ip, int& port) const {
  address_of(socket_, ip, port, getsockname);
}

void RequestStream::drain() {
  ::shutdown(socket_, SHUT_WR);
  const Clock::time_point until = Clock::now() + kLongestDrain;
  std::size_t drained = 0;
  while (drained < kMostDrained && wait_for(POLLIN, until)) {
    const ssize_t received = recv(socket_, buffer_.data(), buffer_.size(), MSG_DONTWAIT);
    if (received <= 0) return;
    drained += static_cast<std::size_t>(received);
  }
}

}  // namespace clampd::daemon
