#include "tools/clampd/control_server.hpp"

#include <sys/stat.h>

#include <charconv>
#include <optional>
#include <random>

#include <fmt/format.h>
#include <openssl/crypto.h>

#include "clampd/record/file.hpp"

// Last: it brings in <resolv.h>, whose macro _res breaks Eigen's headers.
#include <httplib.h>

namespace clampd::daemon {

namespace {

constexpr const char* kJson = "application/json";
constexpr std::size_t kLargestRequest = 64 * 1024;

void answer(httplib::Response& response, int status, const nlohmann::ordered_json& document) {
  response.status = status;
  response.set_content(document.dump(), kJson);
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

std::string random_token() {
  std::random_device entropy;
  std::string token;
  for (int i = 0; i < 8; ++i) token += fmt::format("{:08x}", entropy());
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

struct ControlServer::Http {
  httplib::Server server;
  std::string token;  ///< empty: none is asked for

  /// Whatever moves or stops the brake passes here: no browser page of another origin, and only who has the
  /// token.
  bool may_command(const httplib::Request& request, httplib::Response& response) const {
    if (request.has_header("Origin")) {
      refuse(response, 403, "requests of web pages are refused");
      return false;
    }
    if (!token.empty() && !same_token(request.get_header_value("Authorization"), "Bearer " + token)) {
      refuse(response, 401, "this needs the token of the daemon's token file (Authorization: Bearer ...)");
      return false;
    }
    return true;
  }
};

ControlServer::ControlServer() : http_(std::make_unique<Http>()) {}

Result<std::unique_ptr<ControlServer>> ControlServer::start(ControlTarget& target, const std::string& address,
                                                            int port, const std::string& token_file) {
  std::unique_ptr<ControlServer> control(new ControlServer());
  httplib::Server& server = control->http_->server;
  Http& http = *control->http_;
  if (!token_file.empty()) {
    http.token = random_token();
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
  server.set_payload_max_length(kLargestRequest);
  server.set_read_timeout(5);
  server.set_write_timeout(5);
  server.set_exception_handler(
      [](const auto&, auto& response, std::exception_ptr) { refuse(response, 500, "internal error"); });

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
    std::uint32_t limit = 50;
    if (request.has_param("limit")) {
      const std::string text = request.get_param_value("limit");
      const auto parsed = std::from_chars(text.data(), text.data() + text.size(), limit);
      if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() || limit == 0 || limit > 1000)
        return refuse(response, 400, "limit must be a number from 1 to 1000");
    }
    answer_or_refuse(
        response,
        target.results(request.get_param_value("serial"), request.get_param_value("verdict"), limit), 400);
  });
  server.Get(R"(/v1/results/([A-Za-z0-9_.:-]+))",
             [&target](const httplib::Request& request, httplib::Response& response) {
               answer_or_refuse(response, target.result(request.matches[1]), 404);
             });

  control->port_ =
      port == 0 ? server.bind_to_any_port(address) : (server.bind_to_port(address, port) ? port : -1);
  if (control->port_ < 0)
    return failure(
        fmt::format("cannot listen on {}:{}: the address is not this machine's or another program (another "
                    "clampd?) has the port; change [control] in the configuration",
                    address, port));
  control->thread_ = std::thread([&server] { server.listen_after_bind(); });
  while (!server.is_running()) std::this_thread::yield();
  return control;
}

ControlServer::~ControlServer() {
  http_->server.stop();
  if (thread_.joinable()) thread_.join();
}

}  // namespace clampd::daemon
