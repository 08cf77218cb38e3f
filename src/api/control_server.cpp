#include "clampd/api/control_server.hpp"

#include <arpa/inet.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <functional>
#include <limits>
#include <optional>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <openssl/crypto.h>
#include <spdlog/spdlog.h>

#include "clampd/http/metrics.hpp"
#include "clampd/http/server.hpp"
#include "src/api/token_file.hpp"

namespace clampd::api {

namespace {

using http::refusal;
using http::Request;
using http::Response;
using Names = std::vector<std::string_view>;

constexpr int kNice = -10;  // so that a stop waits for no ordinary process of the machine
constexpr std::string_view kJson = "application/json";
constexpr std::uint32_t kMaxChecks = 1000;  // of one answer

/// Who does what: the archive may wait for a disk and a command for a lock, and neither may keep the other,
/// or the question what the station does now, from being answered. A verdict goes before whoever reads the
/// archive, or a few readers of long lists would keep a small computer from judging.
enum Worker : std::size_t { kCommands, kStation, kArchive };
const std::vector<http::PoolSize> kWorkers{{1, 8}, {1, 32}, {2, 16, 10}};
constexpr std::optional<std::size_t> kAtOnce;

Response answer(const nlohmann::ordered_json& document) {
  // A text that is not UTF-8 is shown with marks in it rather than not at all.
  return {200, document.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace)};
}

Response answer_or_refuse(const Result<nlohmann::ordered_json>& result, int status) {
  return result ? answer(*result) : refusal(status, result.error().message);
}

Response done_or_refuse(const Result<void>& result) {
  return result ? answer(nlohmann::ordered_json::object()) : refusal(409, result.error().message);
}

/// A whole number from `least` to `most` of the query; `absent` where it is not there.
template <class Number>
Result<Number> read_number(const Request& request, std::string_view name, Number least, Number most,
                           Number absent) {
  if (!request.has_parameter(name)) return absent;
  const std::string_view text = request.parameter(name);
  Number number{};
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number);
  if (parsed.ec == std::errc() && parsed.ptr == text.data() + text.size() && number >= least &&
      number <= most)
    return number;
  return failure(fmt::format("{} must be a whole number from {} to {}", name, least, most));
}

/// The check request in a body.
Result<CheckRequest> read_check(const Request& request) {
  Result<CheckRequest> check = parse_check_request(request.body);
  if (!check) return check;
  if (const Result<void> valid = validate(*check); !valid) return tl::unexpected(valid.error());
  return check;
}

const Names kFilter{"serial", "part_number", "batch", "operator", "verdict", "since", "until", "limit"};

/// Which checks are asked for.
Result<CheckFilter> read_filter(const Request& request, std::uint32_t usual_limit) {
  CheckFilter filter;
  const auto limit = read_number<std::uint32_t>(request, "limit", 1, kMaxChecks, usual_limit);
  if (!limit) return tl::unexpected(limit.error());
  filter.limit = *limit;
  filter.serial = request.parameter("serial");
  filter.part_number = request.parameter("part_number");
  filter.batch = request.parameter("batch");
  filter.operator_name = request.parameter("operator");
  filter.since = request.parameter("since");
  filter.until = request.parameter("until");
  const std::string_view verdict = request.parameter("verdict");
  filter.verdict = parse_verdict(verdict);
  if (!verdict.empty() && !filter.verdict)
    return failure("no such verdict; there are PASS, FAIL, ERROR, TIMEOUT, ABORTED");
  for (const std::string& time : {filter.since, filter.until})
    if (!time.empty() && !is_filter_time(time))
      return failure("since and until must be a date 2026-11-21 or a time 2026-11-21T14:30Z (UTC)");
  return filter;
}

bool is_check_id(std::string_view text) {
  constexpr std::string_view kCharacters =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.:-";
  return !text.empty() && text.find_first_not_of(kCharacters) == std::string_view::npos;
}

/// The parts of a path that stand where the pattern has {}; nothing where it does not fit.
std::optional<Names> match(std::string_view pattern, std::string_view path) {
  Names parts;
  while (true) {
    const std::string_view wanted = pattern.substr(0, pattern.find('/'));
    const std::string_view given = path.substr(0, path.find('/'));
    if (wanted == "{}" && is_check_id(given))
      parts.push_back(given);
    else if (wanted != given)
      return std::nullopt;
    if (wanted.size() == pattern.size() || given.size() == path.size()) break;
    pattern.remove_prefix(wanted.size() + 1);
    path.remove_prefix(given.size() + 1);
  }
  if (pattern.find('/') != std::string_view::npos || path.find('/') != std::string_view::npos)
    return std::nullopt;
  return parts;
}

std::string lower(std::string_view text) {
  std::string out(text);
  std::transform(out.begin(), out.end(), out.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  return out;
}

bool same_token(std::string_view given, std::string_view expected) {
  return given.size() == expected.size() &&
         CRYPTO_memcmp(given.data(), expected.data(), expected.size()) == 0;
}

}  // namespace

/// Which request is for whom, and who may.
class ControlServer::Api {
 public:
  Api(ControlTarget& target, std::string token, std::vector<std::string> origins,
      std::span<const http::ScreenFile> screen);

  std::variant<Response, http::Job> route(const Request& request) const;

 private:
  /// `parts`: what stands in the path's places {}.
  using Handler = std::function<Response(const Request& request, const Names& parts)>;
  /// What starts something knows when it was asked for.
  using Starter = std::function<Response(const Request& request, const rt::StartTicket& ticket)>;
  enum class Needs { Nothing, Token, TokenOrThisMachine };
  struct Route {
    std::string_view method;
    std::string_view path;
    std::optional<std::size_t> worker;
    Handler handler;
    Names parameters = {};
    Needs needs = Needs::Nothing;
    bool wants_body = false;
    Starter starter = {};  ///< in place of the handler
  };

  void add_station_routes(ControlTarget& target);
  void add_command_routes(ControlTarget& target);
  void add_archive_routes(ControlTarget& target);
  /// A route that starts something; `start` gets the stops that whoever asks has seen, if that is said.
  void add_start(
      std::string_view path, bool wants_body,
      std::function<Response(const Request&, const rt::StartTicket&, std::optional<std::uint64_t>)> start);

  bool is_own_host(std::string_view host) const;
  bool is_proxied_host(std::string_view host) const;
  bool is_own_origin(const Request& request) const;
  bool is_on_this_machine(const Request& request) const;
  bool has_token(const Request& request) const;
  std::optional<Response> refuse_sender(const Request& request) const;
  std::optional<Response> refuse_form(const Request& request) const;
  std::optional<Response> refuse_for(const Route& route, const Request& request) const;

  ControlTarget& target_;
  const std::string token_;                 ///< empty: none is asked for
  const std::vector<std::string> origins_;  ///< of proxies, in lower case
  std::string machine_;                     ///< this host's name
  std::vector<Route> routes_;
};

ControlServer::Api::Api(ControlTarget& target, std::string token, std::vector<std::string> origins,
                        std::span<const http::ScreenFile> screen)
    : target_(target), token_(std::move(token)), origins_(std::move(origins)) {
  std::array<char, 256> machine{};
  if (gethostname(machine.data(), machine.size() - 1) == 0) machine_ = lower(machine.data());
  for (const http::ScreenFile& file : screen)
    routes_.push_back({"GET", file.path, kAtOnce, [&file](const Request&, const Names&) {
                         return Response{200, std::string(file.content), file.type};
                       }});
  add_command_routes(target);
  add_station_routes(target);
  add_archive_routes(target);
}

void ControlServer::Api::add_command_routes(ControlTarget& target) {
  // By the thread of all connections: a stop waits for no worker, lock or disk, not even for its own body.
  routes_.push_back({"POST",
                     "/v1/stop",
                     kAtOnce,
                     [&target](const Request&, const Names&) { return done_or_refuse(target.stop()); },
                     {},
                     Needs::TokenOrThisMachine});
  routes_.push_back({"POST",
                     "/v1/clear",
                     kCommands,
                     [&target](const Request&, const Names&) { return done_or_refuse(target.clear()); },
                     {},
                     Needs::Token});
  add_start(
      "/v1/checks", true,
      [&target](const Request& request, const rt::StartTicket& ticket, std::optional<std::uint64_t> seen) {
        const Result<CheckRequest> check = read_check(request);
        if (!check) return refusal(400, check.error().message);
        return answer_or_refuse(target.start(*check, ticket, seen).map([](const StartedCheck& started) {
          return nlohmann::ordered_json{{"check", started.check}, {"id", started.id}};
        }),
                                409);
      });
  add_start("/v1/open", false,
            [&target](const Request&, const rt::StartTicket& ticket, std::optional<std::uint64_t> seen) {
              return answer_or_refuse(target.open(ticket, seen).map([](const std::string& id) {
                return nlohmann::ordered_json{{"id", id}};
              }),
                                      409);
            });
  routes_.push_back({"POST",
                     "/v1/next",
                     kCommands,
                     [&target](const Request& request, const Names&) {
                       const Result<CheckRequest> check = read_check(request);
                       return check ? done_or_refuse(target.next(*check))
                                    : refusal(400, check.error().message);
                     },
                     {},
                     Needs::Token,
                     true});
}

void ControlServer::Api::add_start(
    std::string_view path, bool wants_body,
    std::function<Response(const Request&, const rt::StartTicket&, std::optional<std::uint64_t>)> start) {
  const auto starter = [start = std::move(start)](const Request& request, const rt::StartTicket& ticket) {
    if (!request.has_parameter("stops_seen")) return start(request, ticket, std::nullopt);
    constexpr std::uint64_t kAny = std::numeric_limits<std::uint64_t>::max();
    const auto seen = read_number<std::uint64_t>(request, "stops_seen", 0, kAny, 0);
    return seen ? start(request, ticket, *seen) : refusal(400, seen.error().message);
  };
  routes_.push_back({"POST", path, kCommands, {}, {"stops_seen"}, Needs::Token, wants_body, starter});
}

void ControlServer::Api::add_station_routes(ControlTarget& target) {
  routes_.push_back({"GET", "/v1/session", kAtOnce, [this](const Request& request, const Names&) {
                       const bool may_command = has_token(request);
                       return answer({{"token_needed", !token_.empty()},
                                      {"may_command", may_command},
                                      {"may_stop", may_command || is_on_this_machine(request)}});
                     }});
  routes_.push_back({"GET", "/v1/status", kStation, [&target](const Request&, const Names&) {
                       return answer(nlohmann::json(target.status()));
                     }});
  routes_.push_back({"GET", "/metrics", kStation, [&target](const Request&, const Names&) {
                       return Response{200, target.metrics(), http::Metrics::kType};
                     }});
  routes_.push_back({"GET",
                     "/v1/checks/current",
                     kStation,
                     [&target](const Request& request, const Names&) {
                       const auto colour = read_number<unsigned>(request, "colour", 0, 1, 0);
                       if (!colour) return refusal(400, colour.error().message);
                       return answer(progress_json(target.progress(*colour == 1)));
                     },
                     {"colour"}});
  routes_.push_back({"GET", "/v1/reference", kStation,
                     [&target](const Request&, const Names&) { return answer(target.reference()); }});
  routes_.push_back({"GET",
                     "/v1/live",
                     kStation,
                     [&target](const Request& request, const Names&) {
                       constexpr std::uint64_t kAny = std::numeric_limits<std::uint32_t>::max();
                       const auto run = read_number<std::uint64_t>(request, "run", 0, kAny, 0);
                       const auto row = read_number<std::uint64_t>(request, "row", 0, kAny, 0);
                       if (!run) return refusal(400, run.error().message);
                       if (!row) return refusal(400, row.error().message);
                       return answer(target.live(*run, *row));
                     },
                     {"run", "row"}});
}

void ControlServer::Api::add_archive_routes(ControlTarget& target) {
  routes_.push_back({"GET", "/v1/results", kArchive,
                     [&target](const Request& request, const Names&) {
                       const Result<CheckFilter> filter = read_filter(request, 50);
                       if (!filter) return refusal(400, filter.error().message);
                       return answer_or_refuse(target.results(*filter), 503);
                     },
                     kFilter});
  routes_.push_back({"GET", "/v1/results/{}", kArchive, [&target](const Request&, const Names& parts) {
                       return answer_or_refuse(target.result(std::string(parts[0])), 404);
                     }});
  routes_.push_back(
      {"GET", "/v1/results/{}/runs/{}", kArchive, [&target](const Request&, const Names& parts) {
         std::uint16_t number = 0;
         const auto parsed = std::from_chars(parts[1].data(), parts[1].data() + parts[1].size(), number);
         if (parsed.ec != std::errc() || parsed.ptr != parts[1].data() + parts[1].size())
           return refusal(404, "runs are numbered from 0");
         return answer_or_refuse(target.run(std::string(parts[0]), number), 404);
       }});
  routes_.push_back({"GET", "/v1/statistics", kArchive,
                     [&target](const Request& request, const Names&) {
                       const Result<CheckFilter> filter = read_filter(request, 200);
                       if (!filter) return refusal(400, filter.error().message);
                       return answer_or_refuse(target.statistics(*filter), 503);
                     },
                     kFilter});
}

/// A host that no other site can be: a name could be made to point here, an address not.
bool ControlServer::Api::is_own_host(std::string_view host) const {
  std::string name = lower(host);
  if (!name.empty() && name.front() == '[') {
    const std::size_t end = name.find(']');
    if (end == std::string::npos) return false;
    name = name.substr(1, end - 1);
  } else if (const std::size_t colon = name.find(':'); colon != std::string::npos) {
    name.resize(colon);
  }
  std::array<unsigned char, sizeof(in6_addr)> address{};
  return name == "localhost" || (!machine_.empty() && name == machine_) ||
         inet_pton(AF_INET, name.c_str(), address.data()) == 1 ||
         inet_pton(AF_INET6, name.c_str(), address.data()) == 1;
}

/// As a proxy that is named in the configuration may pass it on.
bool ControlServer::Api::is_proxied_host(std::string_view host) const {
  return std::any_of(origins_.begin(), origins_.end(), [&](const std::string& origin) {
    return origin.substr(origin.find("//") + 2) == lower(host);
  });
}

/// Whether a page that sent this, if it was one, came from here or through a proxy that may.
bool ControlServer::Api::is_own_origin(const Request& request) const {
  if (request.header_count("Origin") == 0) return true;
  const std::string origin = lower(request.header("Origin"));
  const std::string_view host = request.header("Host");
  return request.header_count("Origin") == 1 &&
         ((is_own_host(host) && origin == "http://" + lower(host)) ||
          std::find(origins_.begin(), origins_.end(), origin) != origins_.end());
}

/// Not so for what a proxy on this machine passes on for others.
bool ControlServer::Api::is_on_this_machine(const Request& request) const {
  const bool passed_on = request.header_count("Forwarded") + request.header_count("X-Forwarded-For") +
                             request.header_count("Via") >
                         0;
  const std::string_view origin = request.header("Origin");
  const bool other_page = !origin.empty() && lower(origin) != "http://" + lower(request.header("Host"));
  return request.from_this_machine && is_own_host(request.header("Host")) && !passed_on && !other_page;
}

bool ControlServer::Api::has_token(const Request& request) const {
  return token_.empty() || same_token(request.header("Authorization"), "Bearer " + token_);
}

std::optional<Response> ControlServer::Api::refuse_sender(const Request& request) const {
  const std::string_view host = request.header("Host");
  if (request.header_count("Host") != 1 || !(is_own_host(host) || is_proxied_host(host)))
    return refusal(421,
                   "this is not the host that was asked for: use its address, its name or localhost; a "
                   "proxy's name goes into control.origins of the configuration");
  if (!is_own_origin(request) ||
      (request.header("Sec-Fetch-Site") == "cross-site" && request.path.starts_with("/v1/")))
    return refusal(403,
                   "requests of other web pages are refused; the page behind a proxy needs the proxy's "
                   "address in control.origins of the configuration");
  return std::nullopt;
}

std::optional<Response> ControlServer::Api::refuse_form(const Request& request) const {
  if (request.method != "GET" && request.method != "HEAD" && request.method != "POST") {
    Response refused = refusal(405, "there are GET and POST");
    refused.headers.emplace_back("Allow", "GET, HEAD, POST");
    return refused;
  }
  if (request.header_count("Transfer-Encoding") > 0)
    return refusal(411, "the body must come with its length");
  if (request.header_count("Content-Encoding") > 0) return refusal(415, "the body must not be compressed");
  if (request.header_count("Expect") > 0)
    return refusal(417, "send the body at once, without Expect: 100-continue");
  if (request.method == "POST" && !request.header("Content-Type").starts_with(kJson))
    return refusal(415, "the body must be application/json");
  return std::nullopt;
}

/// Whatever moves or stops the brake passes here.
std::optional<Response> ControlServer::Api::refuse_for(const Route& route, const Request& request) const {
  if (route.needs != Needs::Nothing && !has_token(request) &&
      !(route.needs == Needs::TokenOrThisMachine && is_on_this_machine(request)))
    return refusal(
        401,
        "this needs the token of the daemon's token file (Authorization: Bearer ...); for a screen, "
        "`clampctl screen` prints an address that has it");
  for (const auto& [name, value] : request.query)
    if (std::find(route.parameters.begin(), route.parameters.end(), name) == route.parameters.end())
      return refusal(400, route.parameters.empty()
                              ? fmt::format("{} has no parameters, so no \"{}\"", request.path, name)
                              : fmt::format("{} has no parameter \"{}\"; there are {}", request.path, name,
                                            fmt::join(route.parameters, ", ")));
  return std::nullopt;
}

std::variant<Response, http::Job> ControlServer::Api::route(const Request& request) const {
  if (std::optional<Response> refused = refuse_sender(request)) return std::move(*refused);
  if (std::optional<Response> refused = refuse_form(request)) return std::move(*refused);
  const std::string_view method = request.method == "HEAD" ? "GET" : std::string_view(request.method);
  std::string_view other;  // method that this path has
  for (const Route& route : routes_) {
    if (!match(route.path, request.path)) continue;
    other = route.method;
    if (route.method != method) continue;
    if (std::optional<Response> refused = refuse_for(route, request)) return std::move(*refused);
    if (route.starter)
      return http::Job{
          route.worker, route.wants_body,
          [&route, ticket = target_.ticket()](const Request& whole) { return route.starter(whole, ticket); }};
    return http::Job{route.worker, route.wants_body, [&route](const Request& whole) {
                       return route.handler(whole, *match(route.path, whole.path));
                     }};
  }
  if (other.empty()) return refusal(404, fmt::format("there is no {}", request.path));
  Response refused = refusal(405, fmt::format("{} takes {} only", request.path, other));
  refused.headers.emplace_back("Allow", other == "GET" ? "GET, HEAD" : "POST");
  return refused;
}

ControlServer::ControlServer(std::unique_ptr<Api> api, std::unique_ptr<http::Server> server)
    : api_(std::move(api)), server_(std::move(server)) {}
ControlServer::~ControlServer() = default;

int ControlServer::port() const {
  return server_->port();
}

Result<std::unique_ptr<ControlServer>> ControlServer::start(ControlTarget& target,
                                                            const ControlSettings& settings,
                                                            std::span<const http::ScreenFile> screen,
                                                            int inherited) {
  std::string token;
  if (!settings.token_file.empty()) {
    Result<std::string> loaded = load_or_make_token(settings.token_file);
    if (!loaded) return tl::unexpected(loaded.error());
    token = std::move(*loaded);
  }
  auto api = std::make_unique<Api>(target, std::move(token), settings.origins, screen);
  http::Settings http;
  http.address = settings.address;
  http.port = settings.port;
  http.inherited = inherited;
  http.pools = kWorkers;
  http.nice = kNice;
  http.headers = http::screen_headers();
  http.report = [](const std::string& what) { spdlog::error("control API: {}", what); };
  auto server = http::Server::start(std::move(http),
                                    [&api = *api](const Request& request) { return api.route(request); });
  if (!server)
    return failure(server.error().message +
                   ": the address is not this machine's or another program (another clampd?) has the port; "
                   "change [control] in the configuration");
  return std::unique_ptr<ControlServer>(new ControlServer(std::move(api), std::move(*server)));
}

}  // namespace clampd::api
