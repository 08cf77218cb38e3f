#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/http/message.hpp"

namespace clampd::http {

/// What anybody may take of the server's memory and time.
struct Limits {
  std::size_t connections = 256;  ///< at once; for one more, the oldest that dawdles is dropped
  std::size_t header = 16 * 1024;
  std::size_t body = 64 * 1024;
  std::size_t answer = 8 * 1024 * 1024;
  std::size_t answers = 16 * 1024 * 1024;   ///< of all that are being sent; beyond, the oldest is dropped
  std::chrono::milliseconds request{2000};  ///< from the connection to the end of the body
  std::chrono::milliseconds response{10'000};
  std::chrono::milliseconds farewell{500};  ///< for the peer to read the answer before the connection closes
};

/// Threads for what has to wait, and how many requests may wait for one of them.
struct PoolSize {
  std::size_t threads = 1;
  std::size_t waiting = 8;
  int nice = 0;  ///< above 0 the other threads of this process go before them
};

/// What is to be done for a request whose header has been read.
struct Job {
  /// Which of the settings' pools does it; none: the thread of all connections does it at once, so that it
  /// must not wait.
  std::optional<std::size_t> pool;
  bool wants_body = false;
  std::function<Response(const Request&)> answer;
};

/// Sees the header of every request, on the thread of all connections: must not wait.
using Router = std::function<std::variant<Response, Job>(const Request&)>;

struct Settings {
  std::string address;
  int port = 0;  ///< 0: any
  int inherited =
      -1;  ///< a socket that listens already; becomes ours, but whoever shares it may go on with it
  Limits limits = {};
  std::vector<PoolSize> pools = {};
  /// Of the thread of all connections, as far as RLIMIT_NICE allows: below 0 it goes before the pools and
  /// before other ordinary processes. It does little for each request, so that it cannot keep the processor
  /// from them for long.
  int nice = 0;
  Fields headers = {};                                  ///< of every answer
  std::function<void(const std::string&)> report = {};  ///< what went wrong inside; from any thread
};

/// HTTP/1.1, one request a connection, over sockets that never block: one thread serves all connections, and
/// whoever is silent, slow or asks for too much costs the others neither a thread nor their turn. What has to
/// wait (a disk, a lock) is done by worker pools; where one is full, the answer is 503. Where a handler
/// throws, it is 500.
class Server {
 public:
  /// The pools together may hold fewer requests than there are connections, so that one can always be
  /// dropped. Errors: the address is taken, or not this machine's.
  static Result<std::unique_ptr<Server>> start(Settings settings, Router router);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  int port() const;

 private:
  class Implementation;
  explicit Server(std::unique_ptr<Implementation> implementation);
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace clampd::http
