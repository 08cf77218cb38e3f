#include <cstdint>
#include <limits>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/record/checksum.hpp"
#include "clampd/record/utc.hpp"

namespace clampd {
namespace {

TEST(Checksum, KnownAnswers) {
  EXPECT_EQ(sha256_hex(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(sha256_hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Utc, IsRfc3339) {
  EXPECT_EQ(format_utc(0), "1970-01-01T00:00:00.000Z");
  EXPECT_EQ(format_utc(1'795'218'067'123'999'999), "2026-11-20T23:41:07.123Z");
}

TEST(Utc, IsWellFormedBefore1970Too) {
  EXPECT_EQ(format_utc(-1), "1969-12-31T23:59:59.999Z");
  EXPECT_EQ(format_utc(-1'000'000'000), "1969-12-31T23:59:59.000Z");
  EXPECT_EQ(format_utc(std::numeric_limits<std::int64_t>::max()), "2262-04-11T23:47:16.854Z");
}

TEST(Utc, ReadsWhatItWrites) {
  EXPECT_EQ(parse_utc("2026-11-20T23:41:07.123Z"), 1'795'218'067'123'000'000);
  EXPECT_EQ(parse_utc(format_utc(0)), 0);
  for (const char* wrong :
       {"", "2026-11-20", "2026-11-20T23:41:07Z", "2026-02-30T00:00:00.000Z", "2026-11-20T24:00:00.000Z",
        "2026-11-20T23:41:07.123Z ", "1969-12-31T23:59:59.999Z", "2262-04-11T23:47:16.854Z",
        "9999-12-31T00:00:00.000Z", "-001-01-01T00:00:00.000Z"})
    EXPECT_FALSE(parse_utc(wrong)) << wrong;
}

TEST(RecordId, SortsByTimeAndNeverRepeats) {
  EXPECT_THAT(make_record_id(1'795'218'067'123'000'000),
              ::testing::MatchesRegex("20261120T234107123Z-[0-9a-f]{8}"));
  EXPECT_LT(make_record_id(1'795'218'067'123'000'000), make_record_id(1'795'218'067'124'000'000));
  std::set<std::string> ids;
  for (int i = 0; i < 1000; ++i) ids.insert(make_record_id(1));
  EXPECT_GT(ids.size(), 998u);
}

}  // namespace
}  // namespace clampd
