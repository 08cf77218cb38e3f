// Everything that is written in TOML; the first byte says what the rest is.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "clampd/base/assert.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/sheet/sheet.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/limits.hpp"
#include "drivers/sim/plant_configuration.hpp"

namespace {

using namespace clampd;

/// Whatever is refused, the message says in which file.
template <class Read>
bool taken(const Read& read) {
  if (read) return true;
  CLAMPD_ASSERT(read.error().message.starts_with("/x/input.toml:"));
  return false;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string text(reinterpret_cast<const char*>(data + 1), size - 1);
  const std::string file = "/x/input.toml";
  switch (data[0] % 6) {
    case 0:
      // Its model may be in a file of its own, which then is the one that is named.
      if (const auto station = parse_station_configuration(text, file); !station)
        CLAMPD_ASSERT(!station.error().message.empty());
      break;
    case 1:
      if (const auto limits = parse_limits(text, file); taken(limits)) {
        for (const LimitInterval& interval : limits->intervals)
          CLAMPD_ASSERT(interval.lower < interval.upper && std::isfinite(interval.upper - interval.lower));
        CLAMPD_ASSERT(changes_between(*limits, *limits).empty());
      }
      if (const auto sheet = parse_sheet(text, file); taken(sheet))
        for (const Characteristic& line : sheet->characteristics) CLAMPD_ASSERT(line.lower < line.upper);
      break;
    case 2:
      if (const auto brake = parse_brake_parameters(text, file); taken(brake))
        CLAMPD_ASSERT(brake->theta.allFinite());
      break;
    case 3:
      if (const auto model = parse_extended_parameters(text, file); taken(model))
        CLAMPD_ASSERT(taken(parse_extended_parameters(format_extended_parameters(*model), file)));
      break;
    case 4:
      taken(parse_drive_model(text, file));
      break;
    default:
      if (const auto plant = sim::parse_plant_configuration(text, file); taken(plant))
        CLAMPD_ASSERT(plant->validate().has_value());
  }
  return 0;
}
