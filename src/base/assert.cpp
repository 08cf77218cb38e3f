#include "clampd/base/assert.hpp"

#include <cstdio>
#include <cstdlib>

namespace clampd {

void assertion_failed(const char* expression, const char* file, int line) noexcept {
  std::fprintf(stderr, "clampd: internal error: expected %s at %s:%d. Please report this.\n", expression,
               file, line);
  std::abort();
}

}  // namespace clampd
