// A run file, in the station's own columns or through the map of a foreign rig.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "clampd/base/assert.hpp"
#include "clampd/record/run.hpp"

namespace {

using namespace clampd;

void check(const Run& run) {
  CLAMPD_ASSERT(run.size() > 0);
  for (const auto* column : {&run.torque_Nm, &run.velocity_rad_s, &run.force_N, &run.position_rad}) {
    CLAMPD_ASSERT(column->empty() || column->size() == run.size());
    for (const double value : *column) CLAMPD_ASSERT(std::isfinite(value));
  }
  for (std::size_t k = 1; k < run.size(); ++k) CLAMPD_ASSERT(run.time_s[k] > run.time_s[k - 1]);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string text(reinterpret_cast<const char*>(data + 1), size - 1);
  Result<LoadedRun> loaded;
  if (data[0] % 2 == 0) {
    loaded = parse_run(text, "input.csv");
  } else {
    ColumnMap columns;
    columns.time = {"t", 1e-3};
    columns.torque = ColumnSource{"current", 2.5};
    columns.position = ColumnSource{"count", 7.67e-4, 8192.0};
    if (data[0] % 4 == 3) columns.velocity = ColumnSource{"speed", -1.0};
    if (data[0] % 8 > 4) columns.position->late_s = data[0] % 16 > 8 ? 2.5e-3 : -2.5e-3;
    if (const auto header = find_header(text, "input.csv")) {
      CLAMPD_ASSERT(header->names.size() >= 3 && header->skip_lines >= 0);
      columns.skip_lines = header->skip_lines;
    } else {
      CLAMPD_ASSERT(header.error().message.starts_with("input.csv"));
    }
    loaded = parse_run(text, "input.csv", columns);
  }
  if (!loaded) {
    CLAMPD_ASSERT(loaded.error().message.starts_with("input.csv"));
    return 0;
  }
  check(loaded->run);
  if (data[0] % 2 != 0) return 0;
  const auto again = parse_run(format_run(loaded->run), "again.csv");
  CLAMPD_ASSERT(again.has_value());
  CLAMPD_ASSERT(again->run.time_s == loaded->run.time_s && again->run.torque_Nm == loaded->run.torque_Nm &&
                again->run.velocity_rad_s == loaded->run.velocity_rad_s &&
                again->run.force_N == loaded->run.force_N &&
                again->run.position_rad == loaded->run.position_rad);
  return 0;
}
