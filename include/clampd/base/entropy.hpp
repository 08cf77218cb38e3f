#pragma once

#include <random>

namespace clampd {

/// Random bits of the kernel. By default std::random_device asks the processor, and there are processors that
/// return zeros under load (AMD-SB-7055).
inline std::random_device entropy() {
  return std::random_device("getentropy");
}

}  // namespace clampd
