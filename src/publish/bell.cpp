#include "clampd/publish/bell.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "clampd/base/assert.hpp"

namespace clampd::publish {

Bell::Bell() : descriptor_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  CLAMPD_ASSERT(descriptor_ >= 0);
}

Bell::~Bell() {
  ::close(descriptor_);
}

void Bell::ring() noexcept {
  ::eventfd_write(descriptor_, 1);
}

void Bell::stop() noexcept {
  stopped_ = true;
  ring();
}

void Bell::wait(std::chrono::milliseconds longest) noexcept {
  pollfd descriptor{descriptor_, POLLIN, 0};
  ::poll(&descriptor, 1, static_cast<int>(longest.count()));
  silence();
}

void Bell::silence() noexcept {
  eventfd_t rings = 0;
  if (!stopped_) ::eventfd_read(descriptor_, &rings);
}

}  // namespace clampd::publish
