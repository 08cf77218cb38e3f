#include "clampd/publish/wake_event.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <csignal>

#include "clampd/base/assert.hpp"

namespace clampd::publish {

WakeEvent::WakeEvent() : descriptor_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  CLAMPD_ASSERT(descriptor_ >= 0);
}

WakeEvent::~WakeEvent() {
  ::close(descriptor_);
}

void WakeEvent::ring() noexcept {
  ::eventfd_write(descriptor_, 1);
}

void WakeEvent::stop() noexcept {
  stopped_ = true;
  ring();
}

void WakeEvent::wait(std::chrono::milliseconds longest) noexcept {
  pollfd descriptor{descriptor_, POLLIN, 0};
  ::poll(&descriptor, 1, static_cast<int>(longest.count()));
  silence();
}

void WakeEvent::silence() noexcept {
  eventfd_t rings = 0;
  if (!stopped_) ::eventfd_read(descriptor_, &rings);
}

namespace {

WakeEvent& event_of_process() {
  static WakeEvent event;
  return event;
}

}  // namespace

WakeEvent& stopped_by_signals() {
  WakeEvent& event = event_of_process();  // made before any signal may come
  struct sigaction action {};
  action.sa_handler = [](int) { event_of_process().stop(); };
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
  return event;
}

}  // namespace clampd::publish
