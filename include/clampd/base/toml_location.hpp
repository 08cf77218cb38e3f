#pragma once

#include <string>

#include <fmt/format.h>
#include <toml++/toml.h>

namespace clampd {

/// Where a value stands, as messages name it: "model.toml:12".
inline std::string location_of(const std::string& path, const toml::node& node) {
  return fmt::format("{}:{}", path, node.source().begin.line);
}

}  // namespace clampd
