#pragma once

#include <span>

#include "clampd/api/control_server.hpp"

namespace clampd::dashboard {

/// The files of the screen.
std::span<const api::ScreenFile> assets();

}  // namespace clampd::dashboard
