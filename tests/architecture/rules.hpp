#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace clampd::architecture {

using Rooms = std::vector<std::string_view>;

/// THE arrows: what each room may include besides itself. Rooms of `drivers` and `tools` are their folders; `rt` is one room. A room
/// names only rooms above its own line, so that nothing goes in circles.
const std::vector<std::pair<std::string_view, Rooms>>& arrows();

/// The names of the effects that the files of src/brake/effects declare; `content`: of one of them.
std::vector<std::string> effects_named_in(std::string_view content);

/// Where one source file names an effect outside of its comments, as "path:line: what is wrong". Only the effects' own files may, and the
/// simulated brake, which has a table of its own.
std::vector<std::string> effects_named_elsewhere(const std::string& path, std::string_view content,
                                                 const std::vector<std::string>& effects);

/// Every breach of ARCHITECTURE.md's rules in one source file, as "path:line: what is wrong".
/// `path` is relative to the source tree and decides which rules apply; files of tests/ are free.
/// Rules: the arrows between rooms, the libraries that only one room may include, what the real-time path may
/// not use, and that whatever is marked CLAMPD_REALTIME is noexcept.
std::vector<std::string> violations(const std::string& path, std::string_view content);

}  // namespace clampd::architecture
