#pragma once

#include <chrono>
#include <string>

#include "clampd/base/result.hpp"
#include "clampd/publish/wake_event.hpp"

namespace clampd::publish {

/// Whether something listens at host and port: the client libraries' own connect waits for minutes where a
/// network swallows packets, and cannot be told to end. Errors: the name is unknown, or why nobody answers.
Result<void> reachable(const std::string& host, int port, const WakeEvent& wake,
                       std::chrono::milliseconds longest = std::chrono::milliseconds(5000));

}  // namespace clampd::publish
