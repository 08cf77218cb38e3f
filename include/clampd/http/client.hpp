#pragma once

#include <chrono>
#include <cstddef>
#include <string>

#include "clampd/base/result.hpp"
#include "clampd/http/message.hpp"

namespace clampd::http {

/// One request to a server, and how long and how much its answer may be.
struct Call {
  std::string method = "GET";
  std::string path;
  Fields headers = {};
  std::string body = {};  ///< application/json
  std::chrono::milliseconds connect_within{2000};
  std::chrono::milliseconds answer_within{5000};
  std::size_t answer_max = 64 * 1024 * 1024;
};

struct Answer {
  int status = 0;
  std::string body = {};
  Fields headers = {};

  /// The first value of this name; empty if there is none.
  std::string header(const std::string& name) const;
};

/// The answer of the server at this address (a name or number) and port, whatever its status. The error says
/// why none came.
Result<Answer> exchange(const std::string& address, int port, const Call& call);

}  // namespace clampd::http
