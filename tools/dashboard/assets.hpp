#pragma once

#include <span>

#include "clampd/http/screen.hpp"

namespace clampd::dashboard {

/// The files of a station's screen.
std::span<const http::ScreenFile> assets();

/// The files of the page of the line.
std::span<const http::ScreenFile> line_assets();

}  // namespace clampd::dashboard
