#include "tools/clampd/control_server.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstring>
#include <limits>
#include <optional>

#include <fmt/format.h>
#include <openssl/crypto.h>

#include "clampd/base/entropy.hpp"
#include "clampd/record/file.hpp"
#include "tools/dashboard/assets.hpp"

// Last: it brings in <resolv.h> by httplib, whose macro _res breaks Eigen's headers.
#include "tools/clampd/request_stream.hpp"

namespace clampd::daemon {

namespace {

constexpr const char* kJson = "application/json";
constexpr std::size_t kLargestBody = 64 * 1024;
constexpr std::size_t kLargestRequest = kLargestBody + 16 * 1024;  // with its headers
constexpr std::chrono::milliseconds kLongestRequest{2000};

void answer(httplib::Response& response, int status, const nlohmann::ordered_json& document) {
  response.status = status;
  // A text that is not UTF-8 is shown with marks in it rather than not at all.
  response.set_content(document.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace),
                       kJson);
}

void refuse(httplib::Response& response, int status, const std::string& why) {
  answer(response, status, {{"error", why}});
}

void answer_or_refuse(httplib::Response& response, const Result<nlohmann::ordered_json>& result,
                      int refusal) {
  if (result)
    answer(response, 200, *result);
  else
    refuse(response, refusal, result.error().message);
}

constexpr std::size_t kTokenDigits = 64;

/// The token of an earlier start; nothing where the file is not ours alone or holds something else.
std::optional<std::string> earlier_token(const std::string& file) {
  struct stat found {};
  if (lstat(file.c_str(), &found) != 0 || !S_ISREG(found.st_mode) || found.st_uid != geteuid() ||
      (found.st_mode & (S_IWGRP | S_IRWXO)) != 0)
    return std::nullopt;
  Result<std::string> token = read_file(file);
  if (!token || token->size() != kTokenDigits + 1 || token->back() != '\n') return std::nullopt;
  token->pop_back();
  if (token->find_first_not_of("0123456789abcdef") != std::string::npos) return std::nullopt;
  return *token;
}

std::string random_token() {
  std::random_device random = entropy();
  std::string token;
  for (int i = 0; i < 8; ++i) token += fmt::format("{:08x}", random());
  return token;
}

/// Nothing, and the refusal as response, if the body is no valid check request.
std::optional<CheckRequest> read_request(const httplib::Request& request, httplib::Response& response) {
  CheckRequest check;
  try {
    check = nlohmann::json::parse(request.body).get<CheckRequest>();
  } catch (const nlohmann::json::exception& mistake) {
    refuse(response, 400, std::string("the request is not a check request: ") + mistake.what());
    return std::nullopt;
  }
  if (const Result<void> valid = validate(check); !valid) {
    refuse(response, 400, valid.error().message);
    return std::nullopt;
  }
  return check;
}

bool same_token(const std::string& given, const std::string& expected) {
  return given.size() == expected.size() &&
         CRYPTO_memcmp(given.data(), expected.data(), expected.size()) == 0;
}

}  // namespace

struct ControlServer::Http final : public httplib::Server {
  std::string token;    ///< empty: none is asked for
  std::string machine;  ///< this host's name
  std::atomic<bool> stopping{false};

  bool has_token(const httplib::Request& request) const {
    return token.empty() || same_token(request.get_header_value("Authorization"), "Bearer " + token);
  }

  /// Whatever moves or stops the brake passes here.
  bool may_command(const httplib::Request& request, httplib::Response& response) const {
    if (has_token(request)) return true;
    refuse(response, 401,
           "this needs the token of the daemon's token file (Authorization: Bearer ...); for a screen, "
           "`clampctl screen` prints an address that has it");
    return false;
  }

  /// A host that no other site can be: a name could be made to point here, an address not.
  bool is_own_host(const std::string& host) const {
    std::string name = host;
    if (!name.empty() && name.front() == '[') {
      const std::size_t end = name.find(']');
      if (end == std::string::npos) return false;
      name = name.substr(1, end - 1);
    } else if (const std::size_t colon = name.find(':'); colon != std::string::npos) {
      name.resize(colon);
    }
    std::array<unsigned char, sizeof(in6_addr)> address{};
    return name == "localhost" || (!machine.empty() && name == machine) ||
           inet_pton(AF_INET, name.c_str(), address.data()) == 1 ||
           inet_pton(AF_INET6, name.c_str(), address.data()) == 1;
  }

  /// Every request passes here before its body is read.
  HandlerResponse admit(const httplib::Request& request, httplib::Response& response) const {
    const std::string host = request.get_header_value("Host");
    if (request.get_header_value_count("Host") != 1 || !is_own_host(host)) {
      refuse(response, 421,
             "this is not the host that was asked for: use its address, its name or localhost");
    } else if ((request.has_header("Origin") && request.get_header_value("Origin") != "http://" + host) ||
               (request.get_header_value("Sec-Fetch-Site") == "cross-site" &&
                request.path.starts_with("/v1/"))) {
      refuse(response, 403, "requests of other web pages are refused");
    } else if (request.method != "GET" && request.method != "HEAD" && request.method != "POST") {
      response.set_header("Allow", "GET, HEAD, POST");
      refuse(response, 405, "there are GET and POST");
    } else if (request.has_header("Transfer-Encoding")) {
      refuse(response, 411, "the body must come with its length");
    } else if (request.method == "POST" && !request.get_header_value("Content-Type").starts_with(kJson)) {
      refuse(response, 415, "the body must be application/json");
    } else {
      return HandlerResponse::Unhandled;
    }
    return HandlerResponse::Handled;
  }

  /// The socket that was bound, or the one that is given. False: see errno.
  bool take_socket(int inherited) {
    listening_ = inherited >= 0 ? inherited : svr_sock_.exchange(INVALID_SOCKET);
    wake_ = eventfd(0, EFD_CLOEXEC);
    const int flags = fcntl(listening_, F_GETFL);
    return wake_ >= 0 && flags >= 0 && fcntl(listening_, F_SETFL, flags | O_NONBLOCK) == 0;
  }

  /// The library's own loop ends by shutting its socket down, also for whoever shares it.
  void serve() {
    const std::unique_ptr<httplib::TaskQueue> workers(new_task_queue());
    while (!stopping) {
      std::array waiting{pollfd{listening_, POLLIN, 0}, pollfd{wake_, POLLIN, 0}};
      poll(waiting.data(), waiting.size(), -1);
      if (waiting[0].revents == 0) continue;
      const int socket = accept4(listening_, nullptr, nullptr, SOCK_CLOEXEC);
      if (socket >= 0)
        workers->enqueue([this, socket] { process_and_close_socket(socket); });
      else if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM)
        poll(&waiting[1], 1, 10);  // until others have closed some
    }
    workers->shutdown();
  }

  void end() {
    stopping = true;
    eventfd_write(wake_, 1);
  }

  ~Http() override {
    for (const int file : {listening_, wake_})
      if (file >= 0) ::close(file);
  }

 private:
  int listening_ = -1;
  int wake_ = -1;

  /// The library's own lets a connection wait for ever with a byte now and then; here it carries one request.
  bool process_and_close_socket(socket_t socket) override {
    RequestStream stream(socket, kLongestRequest, kLargestRequest, stopping);
    bool closed = false;
    const bool served = process_request(stream, true, closed, nullptr);
    stream.drain();
    ::close(socket);
    return served;
  }
};

namespace {

/// A whole number from `least` to `most` of the query; `absent` where it is not there, nothing (and the
/// refusal as response) where it is something else.
template <class Number>
std::optional<Number> read_number(const httplib::Request& request, httplib::Response& response,
                                  const char* name, Number least, Number most, Number absent) {
  if (!request.has_param(name)) return absent;
  const std::string text = request.get_param_value(name);
  Number number{};
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number);
  if (parsed.ec == std::errc() && parsed.ptr == text.data() + text.size() && number >= least &&
      number <= most)
    return number;
  refuse(response, 400, fmt::format("{} must be a number from {} to {}", name, least, most));
  return std::nullopt;
}

constexpr std::uint32_t kMostResults = 1000;

/// Which checks are asked for; nothing, and the refusal as response, if that cannot be told.
std::optional<CheckFilter> read_filter(const httplib::Request& request, httplib::Response& response) {
  CheckFilter filter;
  const auto limit = read_number<std::uint32_t>(request, response, "limit", 1, kMostResults, filter.limit);
  if (!limit) return std::nullopt;
  filter.limit = *limit;
  filter.serial = request.get_param_value("serial");
  filter.part_number = request.get_param_value("part_number");
  filter.batch = request.get_param_value("batch");
  filter.operator_name = request.get_param_value("operator");
  filter.since = request.get_param_value("since");
  filter.until = request.get_param_value("until");
  const std::string verdict = request.get_param_value("verdict");
  filter.verdict = parse_verdict(verdict);
  if (!verdict.empty() && !filter.verdict) {
    refuse(response, 400, "no such verdict; there are PASS, FAIL, ERROR, TIMEOUT, ABORTED");
    return std::nullopt;
  }
  for (const std::string& time : {filter.since, filter.until})
    if (!time.empty() && !is_filter_time(time)) {
      refuse(response, 400, "since and until must be a date 2026-11-21 or a time 2026-11-21T14:30Z (UTC)");
      return std::nullopt;
    }
  return filter;
}

/// What the screen may do in a browser: nothing but itself, from nowhere else.
httplib::Headers default_headers() {
  return {
      {"Content-Security-Policy",
       "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"},
      {"X-Content-Type-Options", "nosniff"},
      {"X-Frame-Options", "DENY"},
      {"Referrer-Policy", "no-referrer"},
      {"Cross-Origin-Resource-Policy", "same-origin"},
      {"Cross-Origin-Opener-Policy", "same-origin"},
      {"Cache-Control", "no-store"}};
}

}  // namespace

ControlServer::ControlServer() : http_(std::make_unique<Http>()) {}

Result<std::unique_ptr<ControlServer>> ControlServer::start(ControlTarget& target, const std::string& address,
                                                            int port, const std::string& token_file,
                                                            int inherited) {
  std::unique_ptr<ControlServer> control(new ControlServer());
  Http& http = *control->http_;
  httplib::Server& server = http;
  std::array<char, 256> machine{};
  if (gethostname(machine.data(), machine.size() - 1) == 0) http.machine = machine.data();
  if (!token_file.empty()) {
    http.token = earlier_token(token_file).value_or(random_token());
    const mode_t before = umask(0027);  // the operators' group may read it, nobody else
    const Result<void> written = write_file_atomically(token_file, http.token + "\n");
    umask(before);
    if (!written) return tl::unexpected(Error{written.error().message + " (control.token_file)"});
  }

  // Not SO_REUSEPORT, the library's default: a second daemon must not share the port with the first.
  server.set_socket_options([](socket_t socket) {
    const int on = 1;
    setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  });
  // So many may dawdle at once before somebody waits for them.
  server.new_task_queue = [] { return new httplib::ThreadPool(16); };
  server.set_payload_max_length(kLargestBody);
  server.set_default_headers(default_headers());
  server.set_pre_routing_handler([&http](const httplib::Request& request, httplib::Response& response) {
    return http.admit(request, response);
  });
  server.set_exception_handler(
      [](const auto&, auto& response, std::exception_ptr) { refuse(response, 500, "internal error"); });

  for (const dashboard::Asset& asset : dashboard::assets())
    server.Get(std::string(asset.path), [&asset](const httplib::Request&, httplib::Response& response) {
      response.set_content(asset.content.data(), asset.content.size(), std::string(asset.type));
    });
  server.Get("/v1/session", [&http](const httplib::Request& request, httplib::Response& response) {
    answer(response, 200, {{"token_needed", !http.token.empty()}, {"may_command", http.has_token(request)}});
  });
  server.Get("/v1/status", [&target](const httplib::Request&, httplib::Response& response) {
    answer(response, 200, nlohmann::json(target.status()));
  });
  server.Get("/v1/checks/current", [&target](const httplib::Request& request, httplib::Response& response) {
    const control::CheckProgress progress = target.progress(request.get_param_value("colour") == "1");
    answer(response, 200,
           {{"check", progress.check},
            {"finished", progress.finished},
            {"phase", progress.phase},
            {"repeat", progress.repeat},
            {"repeats", progress.repeats},
            {"record", progress.record},
            {"table", progress.table}});
  });
  server.Post("/v1/checks", [&target, &http](const httplib::Request& request, httplib::Response& response) {
    if (!http.may_command(request, response)) return;
    const std::optional<CheckRequest> check = read_request(request, response);
    if (!check) return;
    const Result<std::uint64_t> started = target.start(*check);
    answer_or_refuse(response, started.map([](std::uint64_t number) {
      return nlohmann::ordered_json{{"check", number}};
    }),
                     409);
  });
  server.Post("/v1/next", [&target, &http](const httplib::Request& request, httplib::Response& response) {
    if (!http.may_command(request, response)) return;
    const std::optional<CheckRequest> check = read_request(request, response);
    if (!check) return;
    answer_or_refuse(response, target.next(*check).map([] { return nlohmann::ordered_json::object(); }), 409);
  });
  server.Post("/v1/stop", [&target, &http](const httplib::Request& request, httplib::Response& response) {
    if (!http.may_command(request, response)) return;
    answer_or_refuse(response, target.stop().map([] { return nlohmann::ordered_json::object(); }), 409);
  });
  server.Post("/v1/clear", [&target, &http](const httplib::Request& request, httplib::Response& response) {
    if (!http.may_command(request, response)) return;
    answer_or_refuse(response, target.clear().map([] { return nlohmann::ordered_json::object(); }), 409);
  });
  server.Get("/v1/results", [&target](const httplib::Request& request, httplib::Response& response) {
    if (const std::optional<CheckFilter> filter = read_filter(request, response))
      answer_or_refuse(response, target.results(*filter), 503);
  });
  server.Get(R"(/v1/results/([A-Za-z0-9_.:-]+))",
             [&target](const httplib::Request& request, httplib::Response& response) {
               answer_or_refuse(response, target.result(request.matches[1]), 404);
             });
  server.Get(R"(/v1/results/([A-Za-z0-9_.:-]+)/runs/([0-9]{1,4}))", [&target](const httplib::Request& request,
                                                                              httplib::Response& response) {
    answer_or_refuse(response, target.run(request.matches[1], std::stoul(request.matches[2])), 404);
  });
  server.Get("/v1/statistics", [&target](const httplib::Request& request, httplib::Response& response) {
    const auto limit = read_number<std::uint32_t>(request, response, "limit", 1, kMostResults, 200);
    if (limit) answer_or_refuse(response, target.statistics(*limit), 503);
  });
  server.Get("/v1/reference", [&target](const httplib::Request&, httplib::Response& response) {
    answer(response, 200, target.reference());
  });
  server.Get("/v1/live", [&target](const httplib::Request& request, httplib::Response& response) {
    constexpr std::uint64_t kAny = std::numeric_limits<std::uint32_t>::max();
    const auto run = read_number<std::uint64_t>(request, response, "run", 0, kAny, 0);
    if (!run) return;
    const auto row = read_number<std::uint64_t>(request, response, "row", 0, kAny, 0);
    if (row) answer(response, 200, target.live(*run, *row));
  });

  if (inherited >= 0)
    control->port_ = port;
  else
    control->port_ =
        port == 0 ? server.bind_to_any_port(address) : (server.bind_to_port(address, port) ? port : -1);
  if (control->port_ < 0)
    return failure(
        fmt::format("cannot listen on {}:{}: the address is not this machine's or another program (another "
                    "clampd?) has the port; change [control] in the configuration",
                    address, port));
  if (!http.take_socket(inherited))
    return failure(fmt::format("control API: cannot serve: {}", std::strerror(errno)));
  control->thread_ = std::thread([&http] { http.serve(); });
  return control;
}

ControlServer::~ControlServer() {
  http_->end();
  if (thread_.joinable()) thread_.join();
}

}  // namespace clampd::daemon
