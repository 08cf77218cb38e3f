#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace clampd::http {

/// Names and values in the order in which they came.
using Fields = std::vector<std::pair<std::string, std::string>>;

/// A request as the server read it: first its header, for the router; the body, if anybody wants it, later.
struct Request {
  std::string method;
  std::string path;   ///< decoded: "/v1/results/S-1"
  Fields query = {};  ///< decoded
  Fields headers = {};
  std::string body = {};
  bool from_this_machine = false;  ///< the peer's address is a loopback address, or the server's own

  /// The first value of this name, upper and lower case being the same; empty if there is none.
  std::string_view header(std::string_view name) const;
  std::size_t header_count(std::string_view name) const;
  /// The value of this parameter of the query; empty if there is none.
  std::string_view parameter(std::string_view name) const;
  bool has_parameter(std::string_view name) const;
};

struct Response {
  int status = 200;
  std::string body = {};
  std::string_view type = "application/json";  ///< a constant text, so that saying 500 needs no memory
  Fields headers = {};
};

/// {"error": why}; whatever `why` contains, the answer is valid JSON.
Response refusal(int status, std::string_view why);

/// Whether a text is valid UTF-8, neither overlong nor with halves of surrogate pairs.
bool is_utf8(std::string_view text);

/// Path and query of a request line, decoded. Nothing if it is no path, an escape is broken, a parameter
/// comes twice, or what comes out is not UTF-8.
struct Target {
  std::string path;
  Fields query;
};
std::optional<Target> parse_target(std::string_view text);

}  // namespace clampd::http
