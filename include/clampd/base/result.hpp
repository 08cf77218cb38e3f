#pragma once

#include <string>
#include <utility>

#include <tl/expected.hpp>

namespace clampd {

/// Why an operation could not be done. The message says what went wrong, where, and what to do about it.
struct Error {
  std::string message;
};

/// Outcome of set-up, input/output and storage. Solvers return a summary instead: non-convergence is a
/// result.
template <class T>
using Result = tl::expected<T, Error>;

inline tl::unexpected<Error> failure(std::string message) {
  return tl::unexpected<Error>(Error{std::move(message)});
}

}  // namespace clampd
