#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <string>

#include <httplib.h>

namespace clampd::daemon {

/// One connection of the control API, one request on it. Whoever sends slowly, or too much, finds the stream
/// at its end: the library limits each read and the body, but neither the whole request nor its headers, and
/// a body in chunks not at all. Does not own the socket.
class RequestStream final : public httplib::Stream {
 public:
  /// `stopping`: ends every wait; must outlive this.
  RequestStream(socket_t socket, std::chrono::milliseconds whole_request, std::size_t largest,
                const std::atomic<bool>& stopping);

  bool is_readable() const override;
  bool is_writable() const override;
  ssize_t read(char* out, size_t size) override;
  ssize_t write(const char* data, size_t size) override;
  void get_remote_ip_and_port(std::string& ip, int& port) const override;
  void get_local_ip_and_port(std::string& ip, int& port) const override;
  socket_t socket() const override { return socket_; }

  /// Takes what the peer still sends, so that closing the socket does not reset the connection before the
  /// peer has read why it was refused.
  void drain();

 private:
  using Clock = std::chrono::steady_clock;
  bool wait_for(short events, Clock::time_point until) const;

  socket_t socket_;
  Clock::time_point deadline_;
  std::size_t allowance_;
  const std::atomic<bool>& stopping_;
  std::array<char, 4096> buffer_;
  std::size_t begin_ = 0;
  std::size_t end_ = 0;
};

}  // namespace clampd::daemon
