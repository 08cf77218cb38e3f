#pragma once

#include <poll.h>

#include <chrono>
#include <functional>

namespace clampd::support {

/// Waits until the condition holds; false if it did not within a generous time.
inline bool eventually(const std::function<bool()>& condition,
                       std::chrono::seconds longest = std::chrono::seconds(60)) {
  const auto until = std::chrono::steady_clock::now() + longest;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > until) return false;
    ::poll(nullptr, 0, 2);
  }
  return true;
}

}  // namespace clampd::support
