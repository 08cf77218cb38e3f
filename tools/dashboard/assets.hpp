#pragma once

#include <span>
#include <string_view>

namespace clampd::dashboard {

/// A file of the screen, compiled in, so that the daemon serves nothing from a disk.
struct Asset {
  std::string_view path;  ///< as in the address, e.g. "/screen.js"
  std::string_view type;  ///< MIME
  std::string_view content;
};

std::span<const Asset> assets();

}  // namespace clampd::dashboard
