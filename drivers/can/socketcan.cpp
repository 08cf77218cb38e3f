#include "drivers/can/socketcan.hpp"

#include <fcntl.h>
#include <fmt/core.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/netlink.h>
#include <linux/can/raw.h>
#include <linux/if_link.h>
#include <linux/rtnetlink.h>
#include <net/if.h>
#include <net/if_arp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>

#include "clampd/base/clock.hpp"

namespace clampd::can {
namespace {

std::string reason(int error) {
  return std::generic_category().message(error);
}

/// Closes on destruction.
class Descriptor {
 public:
  explicit Descriptor(int value) : value_{value} {}
  ~Descriptor() {
    if (value_ >= 0) ::close(value_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;

  int get() const { return value_; }
  int release() { return std::exchange(value_, -1); }

 private:
  int value_;
};

std::string no_such_interface(const std::string& name) {
  return fmt::format(
      "there is no CAN interface {0}: check the adapter and its driver ('ip -br link' lists what there is), "
      "or make a "
      "virtual one: ip link add {0} type vcan && ip link set {0} up",
      name);
}

int open_raw_socket() {
  return ::socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
}

std::string no_can(int error) {
  return fmt::format(
      "this kernel gives no raw CAN socket ({}): load the modules (modprobe can-raw), or use a kernel that "
      "has them (Debian: linux-image-amd64 or linux-image-rt-amd64, not the cloud kernels)",
      reason(error));
}

Result<int> open_socket(const std::string& interface, const std::vector<std::uint32_t>& wanted_ids,
                        const BusFormat& format) {
  Descriptor socket{open_raw_socket()};
  if (socket.get() < 0) return failure(no_can(errno));
  const auto info = inspect_interface(interface);
  if (!info) return failure(info.error().message);

  if (format.flexible_data_rate && !info->flexible_data_rate)
    return failure(fmt::format(
        "CAN interface {} is not set up for CAN FD, which the brake's frames need: 'ip link set {} down', "
        "then "
        "'ip link set {} up type can bitrate ... dbitrate ... fd on' (a vcan: 'ip link set {} mtu {}')",
        interface, interface, interface, interface, CANFD_MTU));

  const auto fail = [&](std::string_view what) {
    return failure(fmt::format("CAN interface {}: {} failed: {}", interface, what, reason(errno)));
  };
  std::vector<can_filter> filters;
  for (const std::uint32_t id : wanted_ids) {
    const bool extended = (id & kExtendedId) != 0;
    filters.push_back({id, CAN_EFF_FLAG | CAN_RTR_FLAG | (extended ? CAN_EFF_MASK : CAN_SFF_MASK)});
  }
  if (::setsockopt(socket.get(), SOL_CAN_RAW, CAN_RAW_FILTER, filters.data(),
                   static_cast<socklen_t>(filters.size() * sizeof(can_filter))) != 0) {
    return fail("setting the identifier filters");
  }
  const int flexible_data_rate = format.flexible_data_rate ? 1 : 0;
  if (::setsockopt(socket.get(), SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &flexible_data_rate,
                   sizeof flexible_data_rate) != 0) {
    return fail("asking for CAN FD frames");
  }
  const can_err_mask_t errors = CAN_ERR_MASK;
  if (::setsockopt(socket.get(), SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors) != 0) {
    return fail("asking for error frames");
  }
  const int on = 1;
  if (::setsockopt(socket.get(), SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on) != 0) {
    return fail("asking for time stamps");
  }
  if (::setsockopt(socket.get(), SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on) != 0) {
    return fail("asking for the count of dropped frames");
  }
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = static_cast<int>(info->index);
  if (::bind(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return fail("bind");
  return socket.release();
}

// ---- rtnetlink
// ------------------------------------------------------------------------------------------------------

/// Calls `visit(type, payload)` for every attribute in a block of them.
template <class Visit>
void for_each_attribute(std::span<const std::uint8_t> block, Visit visit) {
  while (block.size() >= sizeof(rtattr)) {
    rtattr header{};
    std::memcpy(&header, block.data(), sizeof header);
    if (header.rta_len < sizeof header || header.rta_len > block.size()) return;
    visit(header.rta_type & NLA_TYPE_MASK, block.subspan(sizeof header, header.rta_len - sizeof header));
    block = block.subspan(std::min<std::size_t>(RTA_ALIGN(header.rta_len), block.size()));
  }
}

template <class T>
T read_as(std::span<const std::uint8_t> payload) {
  T value{};
  std::memcpy(&value, payload.data(), std::min(sizeof value, payload.size()));
  return value;
}

std::string state_name(std::uint32_t state) {
  constexpr std::array kNames{"error-active", "error-warning", "error-passive",
                              "bus-off",      "stopped",       "sleeping"};
  return state < kNames.size() ? kNames[state] : "unknown";
}

void read_link_info(std::span<const std::uint8_t> link_info, InterfaceInfo& info) {
  for_each_attribute(link_info, [&](int type, std::span<const std::uint8_t> payload) {
    if (type == IFLA_INFO_KIND) {
      info.kind.assign(payload.begin(), std::find(payload.begin(), payload.end(), std::uint8_t{0}));
    } else if (type == IFLA_INFO_DATA) {
      for_each_attribute(payload, [&](int data_type, std::span<const std::uint8_t> data) {
        if (data_type == IFLA_CAN_BITTIMING) info.bitrate = read_as<can_bittiming>(data).bitrate;
        if (data_type == IFLA_CAN_DATA_BITTIMING) info.data_bitrate = read_as<can_bittiming>(data).bitrate;
        if (data_type == IFLA_CAN_RESTART_MS) info.restart_ms = read_as<std::uint32_t>(data);
        if (data_type == IFLA_CAN_STATE) info.controller_state = state_name(read_as<std::uint32_t>(data));
      });
    }
  });
}

/// The answer to RTM_GETLINK for one interface.
Result<std::vector<std::uint8_t>> query_link(unsigned index) {
  const Descriptor socket{::socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_ROUTE)};
  if (socket.get() < 0) return failure("rtnetlink: " + reason(errno));
  struct {
    nlmsghdr header;
    ifinfomsg body;
  } request{};
  request.header.nlmsg_len = sizeof request;
  request.header.nlmsg_type = RTM_GETLINK;
  request.header.nlmsg_flags = NLM_F_REQUEST;
  request.body.ifi_index = static_cast<int>(index);
  if (::send(socket.get(), &request, sizeof request, 0) < 0) return failure("rtnetlink: " + reason(errno));
  std::vector<std::uint8_t> answer(1U << 16U);
  const ssize_t received = ::recv(socket.get(), answer.data(), answer.size(), 0);
  if (received < static_cast<ssize_t>(sizeof(nlmsghdr) + sizeof(ifinfomsg))) {
    return failure("rtnetlink: " + reason(errno));
  }
  answer.resize(static_cast<std::size_t>(received));
  return answer;
}

/// The kernel stamps frames with the wall clock. Both clocks of one moment tell a frame's age.
struct ClockPair {
  std::int64_t wall_ns = 0;
  std::int64_t monotonic_ns = 0;

  /// Bounded, in case that the wall clock was set between stamp and moment; none for a frame that came after the moment.
  std::int64_t age_ns(const timespec& stamp) const noexcept {
    const std::int64_t stamp_ns = static_cast<std::int64_t>(stamp.tv_sec) * kNanosecondsPerSecond + stamp.tv_nsec;
    return std::clamp<std::int64_t>(wall_ns - stamp_ns, 0, kNanosecondsPerSecond);
  }
};

ClockPair read_clocks() noexcept {
  timespec wall{};
  ::clock_gettime(CLOCK_REALTIME, &wall);
  return {static_cast<std::int64_t>(wall.tv_sec) * kNanosecondsPerSecond + wall.tv_nsec, monotonic_now_ns()};
}

}  // namespace

Result<InterfaceInfo> inspect_interface(const std::string& name) {
  InterfaceInfo info;
  info.name = name;
  info.index = name.empty() || name.size() >= IFNAMSIZ ? 0 : ::if_nametoindex(name.c_str());
  if (info.index == 0) return failure(no_such_interface(name));
  const auto answer = query_link(info.index);
  if (!answer) return failure(fmt::format("CAN interface {}: {}", name, answer.error().message));
  const auto header = read_as<nlmsghdr>(*answer);
  if (header.nlmsg_type != RTM_NEWLINK) return failure(no_such_interface(name));
  const std::span<const std::uint8_t> message{*answer};
  const auto body = read_as<ifinfomsg>(message.subspan(NLMSG_HDRLEN));
  if (body.ifi_type != ARPHRD_CAN) {
    return failure(
        fmt::format("{} is not a CAN interface: name one of type can or vcan ('ip -br link show type can', "
                    "'ip -br link show type vcan')",
                    name));
  }
  info.up = (body.ifi_flags & IFF_UP) != 0;
  for_each_attribute(message.subspan(NLMSG_HDRLEN + NLMSG_ALIGN(sizeof body)),
                     [&](int type, std::span<const std::uint8_t> payload) {
                       if (type == IFLA_LINKINFO) read_link_info(payload, info);
                       if (type == IFLA_MTU)
                         info.flexible_data_rate = read_as<std::uint32_t>(payload) >= CANFD_MTU;
                       if (type == IFLA_TXQLEN) info.transmit_queue = read_as<std::uint32_t>(payload);
                     });
  std::error_code ignored;
  const auto driver = std::filesystem::read_symlink("/sys/class/net/" + name + "/device/driver", ignored);
  info.driver = driver.filename().string();
  return info;
}

bool kernel_has_can() noexcept {
  return Descriptor{open_raw_socket()}.get() >= 0;
}

void apply_error_frame(const can_frame& frame, BusHealth& health) noexcept {
  ++health.error_frames;
  if ((frame.can_id & CAN_ERR_BUSOFF) != 0) {
    ++health.bus_off_events;
    health.link = LinkState::BusOff;
    return;
  }
  if ((frame.can_id & CAN_ERR_RESTARTED) != 0 && health.link == LinkState::BusOff)
    health.link = LinkState::Up;
  if ((frame.can_id & CAN_ERR_CRTL) != 0) {
    const unsigned detail = frame.data[1];
    if ((detail & CAN_ERR_CRTL_RX_OVERFLOW) != 0) ++health.receive_overflows;
    const bool passive = (detail & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0;
    const bool better =
        (detail & (CAN_ERR_CRTL_ACTIVE | CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)) != 0;
    if (passive && health.link == LinkState::Up) {
      health.link = LinkState::ErrorPassive;
    } else if (!passive && better && health.link == LinkState::ErrorPassive) {
      health.link = LinkState::Up;
    }
  }
}

SocketCanBus::SocketCanBus(std::string interface, std::vector<std::uint32_t> wanted_ids,
                           const BusFormat& format, int descriptor)
    : interface_{std::move(interface)},
      wanted_ids_{std::move(wanted_ids)},
      format_{format},
      descriptor_{descriptor} {}

SocketCanBus::~SocketCanBus() {
  ::close(descriptor_);
}

Result<std::unique_ptr<SocketCanBus>> SocketCanBus::open(const std::string& interface,
                                                         std::vector<std::uint32_t> wanted_ids,
                                                         const BusFormat& format) {
  const auto descriptor = open_socket(interface, wanted_ids, format);
  if (!descriptor) return failure(descriptor.error().message);
  return std::unique_ptr<SocketCanBus>{
      new SocketCanBus{interface, std::move(wanted_ids), format, *descriptor}};
}

Result<void> SocketCanBus::reopen() {
  if (link() != LinkState::Gone) return {};
  const auto fresh = open_socket(interface_, wanted_ids_, format_);
  if (!fresh) return failure(fresh.error().message);
  const Descriptor owner{*fresh};
  // The loop goes on with the same number; the kernel swaps the socket behind it in one step.
  if (::dup3(owner.get(), descriptor_, O_CLOEXEC) < 0) {
    return failure(fmt::format("CAN interface {}: dup3 failed: {}", interface_, reason(errno)));
  }
  // Not Gone any more as of now, so that a second call before the loop's next tick has nothing to do.
  link_.store(LinkState::Down, std::memory_order_relaxed);
  reopened_.store(true, std::memory_order_release);
  return {};
}

void SocketCanBus::note_reopened() noexcept {
  if (!reopened_.exchange(false, std::memory_order_acquire)) return;
  health_.link = LinkState::Up;  // if the interface is down, the next call to the kernel says so
  kernel_drops_ = 0;
}

void SocketCanBus::note_error(int error) noexcept {
  if (error == ENODEV || error == ENXIO) {
    health_.link = LinkState::Gone;
  } else if (error == ENETDOWN && health_.link != LinkState::Gone) {
    health_.link = LinkState::Down;
  }
}

std::size_t SocketCanBus::receive(std::span<TimedFrame> out, std::int64_t now_ns) noexcept {
  note_reopened();
  std::size_t taken = 0;
  std::optional<ClockPair> clocks;  // read once: reading clocks costs more than the rest of a frame
  // Errors (interface down, gone) are each reported once; the bound only keeps a kernel's whim from holding
  // the tick.
  for (int attempts = 0; taken < out.size() && attempts < 256; ++attempts) {
    canfd_frame received;  // the kernel fills in as much as it says
    iovec part{&received, sizeof received};
    alignas(cmsghdr) std::array<char, 128> control;
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    const ssize_t size = ::recvmsg(descriptor_, &message, MSG_DONTWAIT);
    if (size < 0) {
      if (errno == EAGAIN) break;
      if (errno == EINTR) continue;
      note_error(errno);
      if (health_.link == LinkState::Gone) break;
      continue;
    }
    if (size != CAN_MTU && size != CANFD_MTU) continue;

    std::int64_t arrival_ns = now_ns;
    for (cmsghdr* part_header = CMSG_FIRSTHDR(&message); part_header != nullptr;
         part_header = CMSG_NXTHDR(&message, part_header)) {
      if (part_header->cmsg_level != SOL_SOCKET) continue;
      if (part_header->cmsg_type == SO_TIMESTAMPNS) {
        timespec stamp{};
        std::memcpy(&stamp, CMSG_DATA(part_header), sizeof stamp);
        if (!clocks) clocks = read_clocks();
        arrival_ns = clocks->monotonic_ns - clocks->age_ns(stamp);
      } else if (part_header->cmsg_type == SO_RXQ_OVFL) {
        std::uint32_t drops = 0;
        std::memcpy(&drops, CMSG_DATA(part_header), sizeof drops);
        health_.receive_overflows += static_cast<std::uint32_t>(drops - kernel_drops_);
        kernel_drops_ = drops;
      }
    }

    if ((received.can_id & CAN_ERR_FLAG) != 0) {
      can_frame error_frame{};
      std::memcpy(&error_frame, &received, sizeof error_frame);
      apply_error_frame(error_frame, health_);
      continue;
    }
    if ((received.can_id & CAN_RTR_FLAG) != 0) continue;
    TimedFrame& frame = out[taken++];
    frame.frame.id = received.can_id;
    const bool fd = size == CANFD_MTU;
    const bool fast = fd && (received.flags & CANFD_BRS) != 0;
    frame.frame.format = fast ? FrameFormat::FdFastData : fd ? FrameFormat::Fd : FrameFormat::Classic;
    frame.frame.size = std::min<std::uint8_t>(received.len, fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN);
    frame.frame.data.fill(0);
    std::memcpy(frame.frame.data.data(), received.data, frame.frame.size);
    frame.arrival_ns = arrival_ns;
    ++health_.frames_received;
    health_.bus_bits += static_cast<std::uint64_t>(worst_case_bits(frame.frame, format_));
    // A frame from the bus proves that we are on it.
    if (health_.link != LinkState::ErrorPassive) health_.link = LinkState::Up;
  }
  link_.store(health_.link, std::memory_order_relaxed);
  return taken;
}

bool SocketCanBus::send(const Frame& frame, std::int64_t /*now_ns*/) noexcept {
  note_reopened();
  const bool fd = frame.format != FrameFormat::Classic;
  canfd_frame outgoing{};  // begins as a can_frame does
  outgoing.can_id = frame.id;
  outgoing.len = frame.size;
  if (frame.format == FrameFormat::FdFastData) outgoing.flags = CANFD_BRS;
  std::memcpy(outgoing.data, frame.data.data(), frame.size);
  const std::size_t bytes = fd ? CANFD_MTU : CAN_MTU;
  const bool sent =
      ::send(descriptor_, &outgoing, bytes, MSG_DONTWAIT | MSG_NOSIGNAL) == static_cast<ssize_t>(bytes);
  if (sent) {
    ++health_.frames_sent;
    health_.bus_bits += static_cast<std::uint64_t>(worst_case_bits(frame, format_));
    // The kernel took it: the interface is up. A controller in bus-off takes frames, too, so that stays.
    if (health_.link == LinkState::Down || health_.link == LinkState::Gone) health_.link = LinkState::Up;
  } else {
    ++health_.send_failures;
    note_error(errno);
  }
  link_.store(health_.link, std::memory_order_relaxed);
  return sent;
}

BusHealth SocketCanBus::health() const noexcept {
  return health_;
}

}  // namespace clampd::can
