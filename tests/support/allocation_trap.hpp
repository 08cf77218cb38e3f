#pragma once

#include <cstddef>

namespace clampd::support {

/// Counts what the constructing thread takes from and gives back to the heap while the trap exists: malloc
/// and its relatives, and so operator new and delete too. A program arms it by linking allocation_trap.cpp,
/// which stands in front of the C library's malloc (under a sanitizer: hooks into the sanitizer's). One trap
/// a thread at a time.
class AllocationTrap {
 public:
  AllocationTrap();
  ~AllocationTrap();
  AllocationTrap(const AllocationTrap&) = delete;
  AllocationTrap& operator=(const AllocationTrap&) = delete;

  std::size_t allocations() const;
  std::size_t releases() const;
};

}  // namespace clampd::support
