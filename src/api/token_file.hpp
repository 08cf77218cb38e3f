#pragma once

#include <string>

#include "clampd/base/result.hpp"

namespace clampd::api {

/// The API's token: the one in this file, if the file is the daemon's own and nobody else could have written
/// or read it but its group; otherwise a new one, in a new file for owner and group (0640). Why an old one
/// was not taken is logged. Errors: the file cannot be written.
Result<std::string> load_or_make_token(const std::string& file);

}  // namespace clampd::api
