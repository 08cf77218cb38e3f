#pragma once

namespace clampd {

/// Prints the broken expectation and aborts. Never returns.
[[noreturn]] void assertion_failed(const char* expression, const char* file, int line) noexcept;

}  // namespace clampd

/// For programmer errors only, and always on: operating conditions get a Result or a fault instead.
#define CLAMPD_ASSERT(expression) \
  ((expression) ? static_cast<void>(0) : ::clampd::assertion_failed(#expression, __FILE__, __LINE__))
