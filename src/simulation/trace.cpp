#include "clampd/simulation/trace.hpp"

#include <fcntl.h>
#include <fmt/core.h>
#include <unistd.h>

#include <cerrno>
#include <iterator>
#include <string_view>
#include <system_error>
#include <utility>

namespace clampd::plant {
namespace {

Result<void> write_all(int descriptor, std::string_view text, const std::string& path) {
  while (!text.empty()) {
    const ssize_t written = ::write(descriptor, text.data(), text.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return failure(fmt::format("{}: {}", path, std::generic_category().message(errno)));
    text.remove_prefix(static_cast<std::size_t>(written));
  }
  return {};
}

}  // namespace

Result<Trace> Trace::create(const std::string& path) {
  const int descriptor = ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (descriptor < 0) {
    return failure(
        fmt::format("cannot write the trace {}: {}", path, std::generic_category().message(errno)));
  }
  Trace trace{path, descriptor};
  const auto header =
      write_all(descriptor,
                "time_s,sample,torque_Nm,force_N,velocity_rad_s,position_rad,enabled,watchdog,fault\n", path);
  if (!header) return failure(header.error().message);
  return trace;
}

Trace::Trace(Trace&& other) noexcept
    : path_{std::move(other.path_)},
      descriptor_{std::exchange(other.descriptor_, -1)},
      queue_{std::move(other.queue_)},
      dropped_{other.dropped_} {}

Trace::~Trace() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void Trace::put(const TraceRow& row) noexcept {
  if (!queue_->push(row)) ++dropped_;
}

Result<void> Trace::flush() {
  lines_.clear();
  queue_->consume_all([&](const TraceRow& row) {
    fmt::format_to(std::back_inserter(lines_), "{:.6f},{},{:.6g},{:.6g},{:.6g},{:.9g},{:d},{:d},{:d}\n",
                   static_cast<double>(row.time_ns) * 1e-9, row.sample, row.torque_Nm, row.force_N,
                   row.velocity_rad_s, row.position_rad, row.enabled, row.watchdog, row.fault);
  });
  return write_all(descriptor_, lines_, path_);
}

}  // namespace clampd::plant
