#pragma once

#include <memory>

#include <CLI/App.hpp>

#include "clampd/archive/store.hpp"

namespace clampd::ctl {

/// Adds the options that choose checks from the archive (--serial, --part-number, --batch, --operator,
/// --verdict, --since, --until, --limit). The filter is filled when the command is parsed.
/// `limit`: how many by default.
std::shared_ptr<CheckFilter> add_check_selection(CLI::App& command, std::uint32_t limit);

}  // namespace clampd::ctl
