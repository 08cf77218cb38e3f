#pragma once

#include <string_view>

#include "clampd/http/message.hpp"

namespace clampd::http {

/// A file of a page for browsers, compiled in, so that nothing is served from a disk.
struct ScreenFile {
  std::string_view path;  ///< as in the address, e.g. "/screen.js"
  std::string_view type;  ///< MIME
  std::string_view content;
};

/// Of every answer of a server of pages: what they may do in a browser is nothing but themselves, from
/// nowhere else, and nothing is kept.
const Fields& screen_headers();

}  // namespace clampd::http
