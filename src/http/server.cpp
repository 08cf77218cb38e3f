#include "clampd/http/server.hpp"

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <exception>
#include <iterator>
#include <list>
#include <optional>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/basic_stream.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/error.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/status.hpp>
#include <boost/beast/http/string_body.hpp>

#include "clampd/base/assert.hpp"
#include "src/http/worker_pool.hpp"

namespace clampd::http {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
using asio::ip::tcp;
using boost::system::error_code;
using Executor = asio::io_context::executor_type;
using Socket = asio::basic_stream_socket<tcp, Executor>;
using Acceptor = asio::basic_socket_acceptor<tcp, Executor>;
using Stream = beast::basic_stream<tcp, Executor>;
using Timer = asio::basic_waitable_timer<std::chrono::steady_clock,
                                         asio::wait_traits<std::chrono::steady_clock>, Executor>;

/// Of each connection, so that what is on its way in the kernel is bounded too.
constexpr int kSocketBuffer = 128 * 1024;
/// Taken from a peer that goes on sending, so that it can read why it was refused.
constexpr std::size_t kMaxDrained = 4 * 1024 * 1024;
constexpr std::size_t kMaxFields = 100;
constexpr std::chrono::milliseconds kUntilOthersClosed{10};

/// Of the exception that is being handled.
std::string what_was_thrown() {
  try {
    throw;
  } catch (const std::exception& thrown) {
    return thrown.what();
  } catch (...) {
    return "something that is no exception";
  }
}

bool is_loopback(const asio::ip::address& address) {
  if (address.is_v6() && address.to_v6().is_v4_mapped())
    return asio::ip::make_address_v4(asio::ip::v4_mapped, address.to_v6()).is_loopback();
  return address.is_loopback();
}

bool is_from_this_machine(const Socket& socket) {
  error_code missing;
  const tcp::endpoint peer = socket.remote_endpoint(missing);
  if (missing) return false;
  const tcp::endpoint own = socket.local_endpoint(missing);
  return !missing && (is_loopback(peer.address()) || peer.address() == own.address());
}

/// The status of a header that the parser refused; nothing where the peer just went away.
std::optional<Response> refusal_of(const error_code& error) {
  if (error == beast::http::error::header_limit || error == beast::http::error::buffer_overflow)
    return refusal(431, "the header is too large");
  if (error == beast::http::error::body_limit) return refusal(413, "the body is too large");
  if (error == beast::http::error::end_of_stream || error == beast::http::error::partial_message ||
      error.category() != beast::http::make_error_code(beast::http::error::bad_method).category())
    return std::nullopt;
  return refusal(400, "this is not an HTTP request: " + error.message());
}

}  // namespace

class Server::Implementation {
 public:
  Implementation(Settings settings, Router router);
  ~Implementation();

  Result<void> listen();
  void serve();
  int port() const { return port_; }

 private:
  class Connection;
  using Connections = std::list<Connection*>;

  Result<tcp::endpoint> wanted_endpoint();
  Result<void> take_inherited();
  void run() noexcept;
  void accept();
  void pause_before_accepting();
  void admit(Socket socket);
  bool drop_one();
  void reserve(std::size_t bytes, const Connection& reader);
  void report(const Request* request) const noexcept;

  const Settings settings_;
  const Router router_;
  Connections connections_;  ///< the oldest first; each takes itself out when it ends
  std::size_t answers_bytes_ = 0;
  bool accepting_ = false;
  int port_ = 0;
  std::array<char, 16 * 1024> nowhere_{};  ///< for what peers still send; nobody reads it
  // What is still pending when the context goes needs all of the above.
  asio::io_context context_{1};
  Acceptor acceptor_{context_};
  Timer pause_{context_};
  std::vector<std::unique_ptr<WorkerPool>> pools_;
  std::thread thread_;
};

/// One peer, one request. Lives as long as something is under way for it, always on the server's thread but
/// for the worker that makes its answer.
class Server::Implementation::Connection : public std::enable_shared_from_this<Connection> {
 public:
  enum class Phase { Reading, Working, Writing, Draining };

  Connection(Implementation& server, Socket socket)
      : server_(server),
        stream_(std::move(socket)),
        buffer_(server.settings_.limits.header + server.settings_.limits.body) {
    parser_.emplace();
    parser_->header_limit(static_cast<std::uint32_t>(server.settings_.limits.header));
    parser_->body_limit(server.settings_.limits.body);
    entry_ = server.connections_.insert(server.connections_.end(), this);
    listed_ = true;
  }
  ~Connection() { unlist(); }
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  Phase phase() const { return phase_; }

  void begin() {
    request_.from_this_machine = is_from_this_machine(stream_.socket());
    stream_.expires_after(server_.settings_.limits.request);
    beast::http::async_read_header(
        stream_, buffer_, *parser_,
        [self = shared_from_this()](const error_code& error, std::size_t) { self->take_header(error); });
  }

  /// Ends now, whatever is under way. Not while a worker has it.
  void drop() {
    unlist();
    stream_.close();
  }
  /// When no worker is left that could have it.
  void forget_worker() { with_worker_.reset(); }

 private:
  void unlist() {
    if (!listed_) return;
    listed_ = false;
    server_.connections_.erase(entry_);
    server_.answers_bytes_ -= std::exchange(reserved_, 0);
  }

  void refuse(const error_code& error) {
    if (std::optional<Response> refused = refusal_of(error)) send(std::move(*refused));
  }

  void take_header(const error_code& error) {
    if (error) return refuse(error);
    if (!listed_) return;  // dropped meanwhile
    const auto& header = parser_->get();
    const auto fields = std::distance(header.begin(), header.end());
    if (static_cast<std::size_t>(fields) > kMaxFields)
      return send(refusal(431, "the header has too many fields"));
    std::optional<Target> target = parse_target({header.target().data(), header.target().size()});
    if (!target)
      return send(
          refusal(400, "the address is no path with a query in which each name comes once, in UTF-8"));
    request_.method = std::string(header.method_string());
    request_.path = std::move(target->path);
    request_.query = std::move(target->query);
    for (const auto& field : header)
      request_.headers.emplace_back(std::string(field.name_string()), std::string(field.value()));
    head_only_ = request_.method == "HEAD";
    using Routed = std::variant<Response, Job>;
    Routed routed = guarded<Routed>([this] { return server_.router_(request_); });
    if (Response* ready = std::get_if<Response>(&routed)) return send(std::move(*ready));
    job_ = std::move(std::get<Job>(routed));
    if (!job_.wants_body) return work();
    beast::http::async_read(
        stream_, buffer_, *parser_,
        [self = shared_from_this()](const error_code& failed, std::size_t) { self->take_body(failed); });
  }

  void take_body(const error_code& error) {
    if (error) return refuse(error);
    if (!listed_) return;
    request_.body = std::move(parser_->get().body());
    work();
  }

  void work() {
    phase_ = Phase::Working;
    if (!job_.pool) return send(guarded<Response>([this] { return job_.answer(request_); }));
    if (server_.pools_.at(*job_.pool)->offer([this] { work_elsewhere(); })) {
      with_worker_ = shared_from_this();  // in time: what the worker posts runs after this handler
      return;
    }
    Response busy = refusal(503, "the station is busy with other requests; try again in a second");
    busy.headers.emplace_back("Retry-After", "1");
    send(std::move(busy));
  }

  /// On a worker's thread, which alone has request, job and answer meanwhile.
  void work_elsewhere() noexcept {
    answer_ = guarded<Response>([this] { return job_.answer(request_); });
    while (true) {
      try {
        asio::post(server_.context_, [this] { answer_is_made(); });
        return;
      } catch (const std::bad_alloc&) {
        std::this_thread::yield();  // it needs a few bytes, and nobody else ends this connection
      }
    }
  }

  void answer_is_made() {
    const std::shared_ptr<Connection> self = std::exchange(with_worker_, nullptr);
    send(std::move(answer_));
  }

  template <class Outcome, class Work>
  Outcome guarded(const Work& work) const noexcept {
    try {
      return work();
    } catch (...) {
      server_.report(&request_);
      return Response{500};
    }
  }

  void send(Response response) {
    phase_ = Phase::Writing;
    answer_ = std::move(response);
    if (answer_.status == 500 && answer_.body.empty())
      answer_ = refusal(500, "internal error; the daemon's log says more");
    if (answer_.body.size() > server_.settings_.limits.answer)
      answer_ = refusal(500, "the answer is too large; ask for less");
    head_ = fmt::format("HTTP/1.1 {} {}\r\nConnection: close\r\nContent-Type: {}\r\nContent-Length: {}\r\n",
                        answer_.status, reason(answer_.status), answer_.type, answer_.body.size());
    for (const Fields* fields : {&server_.settings_.headers, &std::as_const(answer_.headers)})
      for (const auto& [name, value] : *fields) head_ += fmt::format("{}: {}\r\n", name, value);
    head_ += "\r\n";
    forget_request();
    if (head_only_) answer_.body.clear();
    reserved_ = answer_.body.size();
    server_.reserve(reserved_, *this);
    stream_.expires_after(server_.settings_.limits.response);
    asio::async_write(
        stream_,
        std::array{asio::const_buffer(asio::buffer(head_)), asio::const_buffer(asio::buffer(answer_.body))},
        [self = shared_from_this()](const error_code& error, std::size_t) {
          if (!error) self->say_farewell();
        });
  }

  static std::string_view reason(int status) {
    const auto words = beast::http::obsolete_reason(static_cast<beast::http::status>(status));
    return {words.data(), words.size()};
  }

  /// Who reads slowly shall not keep what he sent as well.
  void forget_request() {
    request_ = Request{};
    job_ = Job{};
    parser_.reset();
    buffer_ = beast::flat_buffer(0);
  }

  /// Closing with bytes unread would reset the connection before the peer has read the answer.
  void say_farewell() {
    phase_ = Phase::Draining;
    server_.answers_bytes_ -= std::exchange(reserved_, 0);
    answer_ = Response{};
    error_code gone;
    stream_.socket().shutdown(tcp::socket::shutdown_send, gone);
    if (gone) return;
    stream_.expires_after(server_.settings_.limits.farewell);
    drain();
  }

  void drain() {
    stream_.async_read_some(asio::buffer(server_.nowhere_),
                            [self = shared_from_this()](const error_code& error, std::size_t count) {
                              self->drained_ += count;
                              if (!error && self->drained_ < kMaxDrained) self->drain();
                            });
  }

  Implementation& server_;
  Stream stream_;
  beast::flat_buffer buffer_;
  std::optional<beast::http::request_parser<beast::http::string_body>> parser_;
  Connections::iterator entry_;
  bool listed_ = false;
  Phase phase_ = Phase::Reading;
  Request request_;
  bool head_only_ = false;
  Job job_;
  std::shared_ptr<Connection> with_worker_;  ///< this one, as long as a worker has it
  Response answer_;
  std::string head_;
  std::size_t reserved_ = 0;
  std::size_t drained_ = 0;
};

Server::Implementation::Implementation(Settings settings, Router router)
    : settings_(std::move(settings)), router_(std::move(router)) {
  std::size_t held = 0;
  for (const PoolSize& size : settings_.pools) {
    pools_.push_back(std::make_unique<WorkerPool>(size.threads, size.waiting, size.nice));
    held += pools_.back()->capacity();
  }
  CLAMPD_ASSERT(held < settings_.limits.connections);
}

Server::Implementation::~Implementation() {
  context_.stop();
  if (thread_.joinable()) thread_.join();
  pools_.clear();  // until now a worker may have had a connection
  const Connections left = connections_;
  for (Connection* connection : left) connection->forget_worker();
}

Result<tcp::endpoint> Server::Implementation::wanted_endpoint() {
  asio::ip::basic_resolver<tcp, Executor> resolver(context_);
  error_code error;
  const auto found = resolver.resolve(settings_.address, std::to_string(settings_.port),
                                      tcp::resolver::passive | tcp::resolver::numeric_service, error);
  if (error || found.empty()) return failure(error.message());
  return found.begin()->endpoint();
}

Result<void> Server::Implementation::take_inherited() {
  sockaddr_storage bound{};
  socklen_t length = sizeof bound;
  error_code error;
  if (getsockname(settings_.inherited, reinterpret_cast<sockaddr*>(&bound), &length) != 0)
    error.assign(errno, boost::system::system_category());
  else
    acceptor_.assign(bound.ss_family == AF_INET6 ? tcp::v6() : tcp::v4(), settings_.inherited, error);
  if (error) return failure("cannot serve on the inherited socket: " + error.message());
  return {};
}

Result<void> Server::Implementation::listen() {
  if (settings_.inherited >= 0) return take_inherited();
  const Result<tcp::endpoint> endpoint = wanted_endpoint();
  error_code error;
  std::string why = endpoint ? "" : endpoint.error().message;
  if (endpoint) {
    // Not SO_REUSEPORT: a second daemon must not share the port with the first.
    acceptor_.open(endpoint->protocol(), error);
    if (!error) acceptor_.set_option(tcp::acceptor::reuse_address(true), error);
    if (!error) acceptor_.bind(*endpoint, error);
    if (!error) acceptor_.listen(tcp::acceptor::max_listen_connections, error);
    if (!error) fcntl(acceptor_.native_handle(), F_SETFD, FD_CLOEXEC);
    if (error) why = error.message();
  }
  if (why.empty()) return {};
  return failure(fmt::format("cannot listen on {}:{} ({})", settings_.address, settings_.port, why));
}

void Server::Implementation::serve() {
  port_ = acceptor_.local_endpoint().port();
  thread_ = std::thread([this] { run(); });
}

void Server::Implementation::run() noexcept {
  // Without the right to it the server works all the same, only later on a loaded machine.
  if (settings_.nice != 0) setpriority(PRIO_PROCESS, static_cast<id_t>(gettid()), settings_.nice);
  while (!context_.stopped()) {
    try {
      if (!accepting_) accept();
      context_.run();
    } catch (...) {
      report(nullptr);  // the connection that it came from has gone with it
    }
  }
}

void Server::Implementation::accept() {
  acceptor_.async_accept([this](const error_code& error, Socket socket) {
    accepting_ = false;
    if (error == asio::error::operation_aborted) return;
    if (!error) admit(std::move(socket));
    if (error == asio::error::no_descriptors || error == asio::error::no_buffer_space ||
        error == asio::error::no_memory || error.value() == ENFILE)
      return pause_before_accepting();
    accept();
  });
  accepting_ = true;
}

/// The process has too many files open, or no memory: until some are closed.
void Server::Implementation::pause_before_accepting() {
  drop_one();
  pause_.expires_after(kUntilOthersClosed);
  pause_.async_wait([this](const error_code& error) {
    if (!error && !accepting_) accept();
  });
}

void Server::Implementation::admit(Socket socket) {
  while (connections_.size() >= settings_.limits.connections && drop_one()) {
  }
  fcntl(socket.native_handle(), F_SETFD, FD_CLOEXEC);
  error_code ignored;
  socket.set_option(asio::socket_base::send_buffer_size(kSocketBuffer), ignored);
  socket.set_option(asio::socket_base::receive_buffer_size(kSocketBuffer), ignored);
  socket.set_option(tcp::no_delay(true), ignored);
  std::make_shared<Connection>(*this, std::move(socket))->begin();
}

/// The oldest of those that have their answer, else of those that do not say what they want, else of those
/// that do not read. What a worker has is no peer's fault and stays; there is always another (see the
/// constructor).
bool Server::Implementation::drop_one() {
  using Phase = Connection::Phase;
  for (const Phase phase : {Phase::Draining, Phase::Reading, Phase::Writing})
    for (Connection* connection : connections_)
      if (connection->phase() == phase) {
        connection->drop();
        return true;
      }
  return false;
}

void Server::Implementation::reserve(std::size_t bytes, const Connection& reader) {
  answers_bytes_ += bytes;
  while (answers_bytes_ > settings_.limits.answers) {
    const auto slow = std::find_if(connections_.begin(), connections_.end(), [&](const Connection* other) {
      return other != &reader && other->phase() == Connection::Phase::Writing;
    });
    if (slow == connections_.end()) return;
    (*slow)->drop();
  }
}

/// To be called where an exception is being handled.
void Server::Implementation::report(const Request* request) const noexcept {
  try {
    const std::string where = request == nullptr ? "a connection" : request->method + " " + request->path;
    if (settings_.report) settings_.report(fmt::format("{}: {}", where, what_was_thrown()));
  } catch (...) {  // there is no memory to say so
  }
}

Server::Server(std::unique_ptr<Implementation> implementation) : implementation_(std::move(implementation)) {}
Server::~Server() = default;

Result<std::unique_ptr<Server>> Server::start(Settings settings, Router router) {
  auto implementation = std::make_unique<Implementation>(std::move(settings), std::move(router));
  if (Result<void> listening = implementation->listen(); !listening) return tl::unexpected(listening.error());
  implementation->serve();
  return std::unique_ptr<Server>(new Server(std::move(implementation)));
}

int Server::port() const {
  return implementation_->port();
}

}  // namespace clampd::http
