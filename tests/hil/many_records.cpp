// A database of so many checks, as a station has that was in use for long: many_records FILE COUNT.

#include <cstdio>
#include <cstdlib>
#include <string>

#include <fmt/format.h>

#include "clampd/archive/store.hpp"
#include "support/check_records.hpp"

int main(int count, char** words) {
  if (count != 3) {
    std::fputs("usage: many_records FILE COUNT\n", stderr);
    return 2;
  }
  auto store = clampd::CheckStore::open(words[1]);
  if (!store) {
    std::fprintf(stderr, "many_records: %s\n", store.error().message.c_str());
    return 1;
  }
  clampd::CheckRecord record = clampd::support::make_check_record();
  // What raw runs take is another matter, and they would not fit into a guest.
  record.runs.clear();
  record.flight_recorder.clear();
  const int checks = std::atoi(words[2]);
  for (int i = 0; i < checks; ++i) {
    // One every minute, which ends before the guest's clock begins.
    const int minute = i % 60, hour = i / 60 % 24, day = i / 1440 % 28, month = i / 40320 % 12;
    record.id = fmt::format("2025{:02}{:02}T{:02}{:02}00000Z-{:08x}", month + 1, day + 1, hour, minute, i);
    record.serial = fmt::format("EMB-{:06}", i);
    record.started = fmt::format("2025-{:02}-{:02}T{:02}:{:02}:00.000Z", month + 1, day + 1, hour, minute);
    record.stopped = fmt::format("2025-{:02}-{:02}T{:02}:{:02}:17.432Z", month + 1, day + 1, hour, minute);
    record.verdict = i % 5 == 0 ? clampd::Verdict::Fail : clampd::Verdict::Pass;
    if (const auto saved = store->save(record); !saved) {
      std::fprintf(stderr, "many_records: %s\n", saved.error().message.c_str());
      return 1;
    }
  }
  return 0;
}
