#include "support/allocation_trap.hpp"

#include <cerrno>
#include <cstdlib>

#include "clampd/base/assert.hpp"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define CLAMPD_SANITIZED_HEAP 1
// From sanitizer/allocator_interface.h, which GCC does not install. Returns 0 if there was no room for the
// hooks.
extern "C" int __sanitizer_install_malloc_and_free_hooks(void (*malloc_hook)(const volatile void*,
                                                                             std::size_t),
                                                         void (*free_hook)(const volatile void*));
#endif

namespace {

// Touched from inside malloc, so it must not need any initialisation at run time.
struct Counts {
  bool armed;
  std::size_t allocations;
  std::size_t releases;
};
constinit thread_local Counts counts{false, 0, 0};

void note_allocation() noexcept {
  if (counts.armed) ++counts.allocations;
}

void note_release(const volatile void* block) noexcept {
  if (counts.armed && block != nullptr) ++counts.releases;
}

}  // namespace

#ifdef CLAMPD_SANITIZED_HEAP

namespace {
const int hooks_installed =
    __sanitizer_install_malloc_and_free_hooks([](const volatile void*, std::size_t) { note_allocation(); },
                                              [](const volatile void* block) { note_release(block); });
}  // namespace

#else

extern "C" {

void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* block, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);
void __libc_free(void* block);

void* malloc(std::size_t size) {
  note_allocation();
  return __libc_malloc(size);
}

void* calloc(std::size_t count, std::size_t size) {
  note_allocation();
  return __libc_calloc(count, size);
}

void* realloc(void* block, std::size_t size) {
  note_allocation();
  note_release(block);
  return __libc_realloc(block, size);
}

void* memalign(std::size_t alignment, std::size_t size) {
  note_allocation();
  return __libc_memalign(alignment, size);
}

void* aligned_alloc(std::size_t alignment, std::size_t size) {
  note_allocation();
  return __libc_memalign(alignment, size);
}

int posix_memalign(void** block, std::size_t alignment, std::size_t size) {
  note_allocation();
  *block = __libc_memalign(alignment, size);
  return *block == nullptr ? ENOMEM : 0;
}

void free(void* block) {
  note_release(block);
  __libc_free(block);
}

}  // extern "C"

#endif

namespace clampd::support {

AllocationTrap::AllocationTrap() {
#ifdef CLAMPD_SANITIZED_HEAP
  CLAMPD_ASSERT(hooks_installed != 0);
#endif
  CLAMPD_ASSERT(!counts.armed);
  counts = {true, 0, 0};
}

AllocationTrap::~AllocationTrap() {
  counts.armed = false;
}

std::size_t AllocationTrap::allocations() const {
  return counts.allocations;
}

std::size_t AllocationTrap::releases() const {
  return counts.releases;
}

}  // namespace clampd::support
