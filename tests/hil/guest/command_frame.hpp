// The station's command frame on a CAN interface, for the guest's programs that act at a moment of the drive.
#pragma once

#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <cerrno>
#include <string>

inline ifreq interface_request(const std::string& name) {
  ifreq request{};
  name.copy(request.ifr_name, IFNAMSIZ - 1);
  return request;
}

/// A raw socket on the interface; -1 with errno where there is none.
inline int open_can(const std::string& interface) {
  const int handle = socket(PF_CAN, SOCK_RAW, CAN_RAW);
  ifreq request = interface_request(interface);
  if (handle < 0 || ioctl(handle, SIOCGIFINDEX, &request) < 0) return -1;
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = request.ifr_ifindex;
  return bind(handle, reinterpret_cast<sockaddr*>(&address), sizeof address) < 0 ? -1 : handle;
}

enum class Command {
  Enable,  ///< the lowest bit of the third byte
  Torque,  ///< a torque that is not zero, its first two bytes, with Enable
};

/// Reads frames until a command frame of the station asks for `wanted`. False, with errno, after 10 s without
/// any frame or after 100,000 frames: the station also sends commands while it drives nothing.
inline bool wait_for_command(int handle, Command wanted) {
  constexpr canid_t kBrakeCommand = 0x100;
  const timeval silence{.tv_sec = 10, .tv_usec = 0};
  setsockopt(handle, SOL_SOCKET, SO_RCVTIMEO, &silence, sizeof silence);
  can_frame frame{};
  for (int count = 0; count < 100'000; ++count) {
    if (read(handle, &frame, sizeof frame) != sizeof frame) return false;
    const bool enabled = (frame.data[2] & 1) != 0;
    const bool turns = frame.data[0] != 0 || frame.data[1] != 0;
    if (frame.can_id == kBrakeCommand && enabled && (wanted == Command::Enable || turns)) return true;
  }
  errno = ETIME;
  return false;
}
