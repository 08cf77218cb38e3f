#include "clampd/base/version.hpp"

namespace clampd {

const std::string_view kVersion = CLAMPD_VERSION;

}  // namespace clampd
