#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace clampd::architecture {

/// Every breach of ARCHITECTURE.md's rules in one source file, as "path:line: what is wrong".
/// `path` is relative to the source tree and decides which rules apply; files of tests/ are free.
/// Rules: the arrows between rooms, the libraries that only one room may include, what the real-time path may
/// not use, and that whatever is marked CLAMPD_REALTIME is noexcept.
std::vector<std::string> violations(const std::string& path, std::string_view content);

}  // namespace clampd::architecture
