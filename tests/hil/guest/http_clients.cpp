// Clients of the station's HTTP server that no proper program would be, and a stop among them.
//
//   http_clients PORT crowd COUNT
//       keeps COUNT connections until it is told to end; "ready" once all of them are there
//   http_clients PORT stop INTERFACE
//       asks for a stop as soon as a command frame asks for torque; "MONOTONIC REALTIME ANSWERED", in
//       seconds: both clocks immediately before it connects, and the monotonic one when the answer, 200, is
//       there
//
// A sixth of the crowd each is silent, sends its header byte by byte, never ends its body, does not read a
// large answer, does not read a list of results, and reads one list of results after the other.

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "command_frame.hpp"

namespace {

[[noreturn]] void give_up(const char* what) {
  std::perror((std::string("http_clients: ") + what).c_str());
  std::exit(2);
}

double now_s(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

sockaddr_in station(int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

const std::string kHost = " HTTP/1.1\r\nHost: localhost\r\n";
const std::string kResults = "GET /v1/results?limit=1000" + kHost + "\r\n";

struct Kind {
  std::string beginning;
  bool drips = false;
  bool reads = false;
};

const std::array<Kind, 6> kKinds{{
    {""},
    {"POST /v1/stop" + kHost + "X-Slow: ", true},
    {"POST /v1/checks" + kHost + "Content-Type: application/json\r\nContent-Length: 60000\r\n\r\n{"},
    {"GET /screen.js" + kHost + "\r\n"},
    {kResults},
    {kResults, false, true},
}};

class Crowd {
 public:
  Crowd(int port, std::size_t count) : address_(station(port)), sockets_(count) {
    const rlimit files{count + 64, count + 64};
    if (setrlimit(RLIMIT_NOFILE, &files) != 0) give_up("so many open files");
    for (std::size_t i = 0; i < count; ++i) connect(i);
  }

  /// Keeps them until SIGTERM, and brings back those that the station closes, twenty in a tenth of a second
  /// at most, one after the other. They leave like that, too: where several go at once, what the kernel has to
  /// do for them keeps one slow processor from delivering frames for longer than a brake may be silent.
  void keep() {
    std::signal(SIGTERM, [](int) { leaving = 1; });
    while (leaving == 0) {
      std::size_t closed = 0;
      if (poll(sockets_.data(), sockets_.size(), 100) < 0 && errno != EINTR) give_up("poll");
      for (std::size_t i = 0; i < sockets_.size(); ++i) {
        if (kind(i).drips) ::send(sockets_[i].fd, "x", 1, MSG_NOSIGNAL | MSG_DONTWAIT);
        if (sockets_[i].revents == 0 || read(i) || closed == kMost) continue;
        connect(i);
        ++closed;
        usleep(kPause_us);
      }
      usleep(static_cast<useconds_t>(kMost - closed) * kPause_us);
    }
    for (const pollfd& socket : sockets_) {
      close(socket.fd);
      usleep(kPause_us);
    }
  }

 private:
  static constexpr std::size_t kMost = 20;  ///< brought back in a round
  static constexpr useconds_t kPause_us = 5'000;
  static inline volatile std::sig_atomic_t leaving = 0;

  static const Kind& kind(std::size_t i) { return kKinds[i % kKinds.size()]; }

  void connect(std::size_t i) {
    if (sockets_[i].fd > 0) close(sockets_[i].fd);
    const int handle = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const int little = 1;
    if (!kind(i).reads) setsockopt(handle, SOL_SOCKET, SO_RCVBUF, &little, sizeof little);
    if (handle < 0 || ::connect(handle, reinterpret_cast<const sockaddr*>(&address_), sizeof address_) != 0)
      give_up("connect");
    const std::string& text = kind(i).beginning;
    if (!text.empty()) ::send(handle, text.data(), text.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    sockets_[i] = {handle, static_cast<short>(kind(i).reads ? POLLIN | POLLRDHUP : POLLRDHUP), 0};
  }

  /// False if the station has closed the connection.
  bool read(std::size_t i) {
    if ((sockets_[i].revents & (POLLRDHUP | POLLHUP | POLLERR)) != 0) return false;
    std::array<char, 65536> buffer;
    return ::recv(sockets_[i].fd, buffer.data(), buffer.size(), MSG_DONTWAIT) != 0;
  }

  sockaddr_in address_;
  std::vector<pollfd> sockets_;
};

void stop(int port, const std::string& interface) {
  const std::string request =
      "POST /v1/stop" + kHost +
      "Content-Type: application/json\r\nContent-Length: 2\r\nConnection: close\r\n\r\n{}";
  const std::string expected = "HTTP/1.1 200";
  std::string answer;
  std::array<char, 512> buffer;
  const sockaddr_in address = station(port);
  const int bus = open_can(interface);
  if (bus < 0) give_up(interface.c_str());
  // What is measured is the station: nothing ordinary comes between the clocks and the request, or the
  // answer.
  const sched_param priority{.sched_priority = 10};
  if (sched_setscheduler(0, SCHED_FIFO, &priority) != 0) give_up("real-time priority");
  // Between two runs of a check no torque is asked for; a stop that came there would show nothing.
  if (!wait_for_command(bus, Command::Torque)) give_up("no command for torque");
  const double monotonic_s = now_s(CLOCK_MONOTONIC);
  const double realtime_s = now_s(CLOCK_REALTIME);
  const int handle = socket(AF_INET, SOCK_STREAM, 0);
  if (handle < 0 || connect(handle, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      send(handle, request.data(), request.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(request.size()))
    give_up("stop");
  while (answer.size() < expected.size()) {
    const ssize_t count = recv(handle, buffer.data(), buffer.size(), 0);
    if (count <= 0) break;
    answer.append(buffer.data(), static_cast<std::size_t>(count));
  }
  const double answered_s = now_s(CLOCK_MONOTONIC);
  if (answer.compare(0, expected.size(), expected) != 0) {
    std::fprintf(stderr, "http_clients: the answer to a stop is '%s'\n", answer.c_str());
    std::exit(1);
  }
  std::printf("%.6f %.6f %.6f\n", monotonic_s, realtime_s, answered_s);
}

}  // namespace

int main(int count, char** words) {
  const int port = count > 2 ? std::atoi(words[1]) : 0;
  const std::string verb = count > 2 ? words[2] : "";
  if (verb == "crowd" && count == 4) {
    Crowd crowd(port, static_cast<std::size_t>(std::atoi(words[3])));
    std::puts("ready");
    std::fflush(stdout);
    crowd.keep();
    return 0;
  }
  if (verb == "stop" && count == 4) {
    stop(port, words[3]);
    return 0;
  }
  std::fputs("usage: http_clients PORT crowd COUNT | stop INTERFACE\n", stderr);
  return 2;
}
