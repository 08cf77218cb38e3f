#pragma once

#include "clampd/base/assert.hpp"
#include "clampd/station/limits.hpp"

namespace clampd::support {

/// configs/limits.toml.
inline LimitSet shipped_limits() {
  const Result<LimitSet> limits = read_limits(CLAMPD_SOURCE_DIR "/configs/limits.toml");
  CLAMPD_ASSERT(limits.has_value());
  return *limits;
}

}  // namespace clampd::support
