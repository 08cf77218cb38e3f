#include "clampd/ports/brake_port.hpp"

namespace clampd {

std::string_view to_string(LinkState link) noexcept {
  switch (link) {
    case LinkState::Up:
      return "up";
    case LinkState::ErrorPassive:
      return "error-passive";
    case LinkState::BusOff:
      return "bus-off";
    case LinkState::Down:
      return "down";
    case LinkState::Gone:
      return "gone";
  }
  return "?";
}

}  // namespace clampd
