#pragma once

/// Marks a function that the 1 kHz tick reaches: it must not allocate, lock, log, throw or block.
/// It is written before the declaration and always together with noexcept. The allocation trap
/// (tests/support/allocation_trap.hpp) proves the first of these over 10^4 ticks.
#if defined(__clang__)
#define CLAMPD_REALTIME [[clang::annotate("clampd::realtime")]]
#else
#define CLAMPD_REALTIME
#endif
