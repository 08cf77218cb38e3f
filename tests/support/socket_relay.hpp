#pragma once

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstring>
#include <list>
#include <mutex>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

namespace clampd::support {

/// A network between clients and a PostgreSQL that listens on a socket: passes bytes on until it is told not
/// to.
class SocketRelay {
 public:
  /// Clients find it in `folder`, the server is in the other one. Throws where it cannot listen.
  SocketRelay(std::string folder, std::string server)
      : folder_(std::move(folder)), server_(std::move(server)) {
    const sockaddr_un address = address_in(folder_);
    listening_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (::bind(listening_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
        ::listen(listening_, 16) != 0)
      throw std::runtime_error("cannot listen in " + folder_);
    thread_ = std::jthread([this](const std::stop_token& stopping) { work(stopping); });
  }
  ~SocketRelay() {
    thread_ = {};
    ::close(listening_);
  }
  SocketRelay(const SocketRelay&) = delete;
  SocketRelay& operator=(const SocketRelay&) = delete;

  std::string socket() const { return path_in(folder_); }
  /// Nothing passes, and nobody hears that nothing does; what was sent meanwhile passes after release().
  void hold() { held_ = true; }
  void release() { held_ = false; }
  /// Ends all connections, and each new one at once, until mend().
  void cut() { cut_ = true; }
  void mend() { cut_ = false; }
  /// Of the next client that sends this text, nothing passes after it, for good.
  void hold_after(std::string text) {
    const std::lock_guard lock(mutex_);
    hold_after_ = std::move(text);
  }
  /// As soon as a client sends this text, which does not pass any more, it cuts.
  void cut_at(std::string text) {
    const std::lock_guard lock(mutex_);
    cut_at_ = std::move(text);
  }
  bool is_cut() const { return cut_; }
  /// Whether one is held after its text.
  bool holds_one() const { return holds_one_; }

 private:
  struct Pair {
    int client = -1, server = -1;
    bool client_held = false;
  };

  static std::string path_in(const std::string& folder) { return folder + "/.s.PGSQL.5432"; }
  static sockaddr_un address_in(const std::string& folder) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::string path = path_in(folder);
    if (path.size() >= sizeof address.sun_path) throw std::runtime_error("too long a path: " + path);
    std::memcpy(address.sun_path, path.c_str(), path.size());
    return address;
  }

  void work(const std::stop_token& stopping) {
    constexpr int kNone = -1;    // is not waited for
    constexpr int kLook_ms = 5;  // how soon it hears what it is told
    while (!stopping.stop_requested()) {
      std::vector<pollfd> waiting{{listening_, POLLIN, 0}};
      for (const Pair& pair : pairs_)
        for (const int end : {pair.client_held ? kNone : pair.client, pair.server})
          waiting.push_back({end, POLLIN, 0});
      ::poll(waiting.data(), held_ ? 1 : waiting.size(), kLook_ms);
      if ((waiting[0].revents & POLLIN) != 0) accept();
      std::size_t at = 1;
      for (auto pair = pairs_.begin(); pair != pairs_.end(); at += 2) {
        const bool lives = !cut_ && (held_ || (passes(*pair, waiting, at)));
        pair = lives ? std::next(pair) : end(pair);
      }
    }
    while (!pairs_.empty()) end(pairs_.begin());
  }
  void accept() {
    Pair pair{::accept4(listening_, nullptr, nullptr, SOCK_CLOEXEC)};
    const sockaddr_un address = address_in(server_);
    pair.server = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    pairs_.push_back(pair);
    if (::connect(pair.server, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      end(std::prev(pairs_.end()));
  }
  /// Both ways; false if either end has closed. A pair that came after the poll has nothing yet.
  bool passes(Pair& pair, const std::vector<pollfd>& waiting, std::size_t at) {
    if (at + 1 >= waiting.size()) return true;
    if (waiting[at].revents != 0 && !pass(pair.client, pair.server, &pair)) return false;
    return waiting[at + 1].revents == 0 || pass(pair.server, pair.client, nullptr);
  }
  bool pass(int from, int to, Pair* client) {
    std::array<char, 65536> buffer;
    const ssize_t count = ::recv(from, buffer.data(), buffer.size(), 0);
    if (count <= 0) return false;
    const std::string_view bytes(buffer.data(), static_cast<std::size_t>(count));
    if (client != nullptr) {
      const std::lock_guard lock(mutex_);
      if (!hold_after_.empty() && bytes.find(hold_after_) != std::string_view::npos) {
        hold_after_.clear();
        client->client_held = holds_one_ = true;
      }
      if (!cut_at_.empty() && bytes.find(cut_at_) != std::string_view::npos) {
        cut_at_.clear();
        cut_ = true;
        return false;
      }
    }
    for (std::size_t sent = 0; sent < bytes.size();) {
      const ssize_t part = ::send(to, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
      if (part <= 0) return false;
      sent += static_cast<std::size_t>(part);
    }
    return true;
  }
  std::list<Pair>::iterator end(std::list<Pair>::iterator pair) {
    ::close(pair->client);
    ::close(pair->server);
    return pairs_.erase(pair);
  }

  std::string folder_, server_;
  int listening_ = -1;
  std::atomic<bool> held_{false}, cut_{false}, holds_one_{false};
  std::mutex mutex_;
  std::string hold_after_, cut_at_;
  std::list<Pair> pairs_;  ///< of the thread
  std::jthread thread_;    ///< last: it uses all of the above
};

}  // namespace clampd::support
