#include "clampd/attribution/line_table.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/temporary_directory.hpp"

namespace clampd::attribution {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr const char* kHeader =
    "record,serial,batch,station,fixture,started,verdict,reason,simulated,void,k1 [N/rad],k1 sd "
    "[N/rad],sheet drag [N m],sheet drag sd "
    "[N m],TC lower [N m]\r\n";

std::string row(int number, const std::string& station, const std::string& verdict = "PASS",
                const std::string& value = "12.5") {
  return fmt::format(
      "R{0},S{0},B{1},{2},,2026-11-20T0{3}:00:00.000Z,{4},\"quoted, with\na line "
      "break\",0,,{5},0.1,1,1,2\r\n",
      number, number / 4, station, number % 10, verdict, value);
}

class LineTables : public ::testing::Test {
 protected:
  std::string file(const std::string& name, const std::string& text) { return directory_.write(name, text); }
  std::string error(const std::string& text) {
    const auto table = read_line_table({file("bad.csv", text)});
    return table ? "read" : table.error().message;
  }
  support::TemporaryDirectory directory_;
};

TEST_F(LineTables, AreReadFromTheTablesOfSeveralStations) {
  std::string one = kHeader, two = kHeader;
  for (int i = 0; i < 10; ++i) one += row(i, "A");
  for (int i = 5; i < 15; ++i) two += row(i, "B");
  two += row(20, "B", "ERROR", "") + row(21, "B", "PASS", "") + row(14, "B");
  const auto table = read_line_table({file("a.csv", one), file("b.csv", two)});
  ASSERT_TRUE(table) << table.error().message;
  EXPECT_EQ(table->checks(), 20u);
  EXPECT_EQ(table->rows, 23u);
  EXPECT_EQ(table->invalid, 1u);
  EXPECT_EQ(table->incomplete, 1u);
  EXPECT_EQ(table->doubled, 1u);
  EXPECT_THAT(table->stations, ElementsAre("A", "B"));
  EXPECT_THAT(table->batches, ElementsAre("B0", "B1", "B2", "B3"));
  EXPECT_EQ(table->layout.brakes, 15);
  ASSERT_EQ(table->parameters.size(), 1u);
  EXPECT_EQ(table->parameters[0].name, "k1");
  EXPECT_EQ(table->parameters[0].unit, "N/rad");
  EXPECT_DOUBLE_EQ(table->parameters[0].values[3], 12.5);
  EXPECT_DOUBLE_EQ(table->last_s - table->first_s, 9.0 * 3600.0);
  EXPECT_DOUBLE_EQ(table->first_s, 1795132800.0);
}

TEST_F(LineTables, SimulatedBrakesCountWhereThereAreNoOthers) {
  std::string text = kHeader;
  for (int i = 0; i < 24; ++i) text += row(i, "A");
  std::string mixed = text;
  for (std::size_t at = 0, n = 0; n < 8; ++n) mixed.replace(at = mixed.find("\",0,", at) + 2, 1, "1");
  auto table = read_line_table({file("mixed.csv", mixed)});
  ASSERT_TRUE(table) << table.error().message;
  EXPECT_EQ(table->checks(), 16u);
  EXPECT_EQ(table->simulated, 8u);
  EXPECT_EQ(table->layout.brakes, 16);
}

TEST_F(LineTables, WhatIsWrongIsSaidWithItsPlace) {
  EXPECT_THAT(error(""), HasSubstr("bad.csv: is empty"));
  EXPECT_THAT(error("serial,station,verdict\n"), HasSubstr("bad.csv:1: there is no column started"));
  EXPECT_THAT(error("serial,station,started,verdict\n"),
              HasSubstr("has 0 parameters with a standard deviation"));
  EXPECT_THAT(error(kHeader + row(1, "A") + "R2,S2\r\n"),
              HasSubstr("bad.csv:4: 2 columns, the header has 15"));
  EXPECT_THAT(error(kHeader + row(1, "A", "PASS", "12,5")), HasSubstr("bad.csv:3: 16 columns"));
  EXPECT_THAT(error(kHeader + row(1, "A", "PASS", "nan")), HasSubstr("bad.csv:3:11: 'nan' is not a number"));
  EXPECT_THAT(error(kHeader + row(1, "A")), HasSubstr("1 of 1 rows are valid checks: too few"));
  EXPECT_THAT(read_line_table({"/nowhere/x.csv"}).error().message,
              HasSubstr("/nowhere/x.csv: cannot be read"));
  const std::string parts =
      "serial,part_number,station,started,verdict,k1 [N],k1 sd [N]\n"
      "1,P,A,2026-11-20T00:00:00Z,PASS,1,1\n"
      "2,Q,A,2026-11-20T00:00:00Z,PASS,1,1\n";
  EXPECT_THAT(error(parts), HasSubstr("bad.csv:3: part number 'Q', before 'P'"));
  std::string time = kHeader + row(1, "A");
  time.replace(time.find("2026-11-20"), 10, "2026-13-20");
  EXPECT_THAT(error(time), HasSubstr("bad.csv:3:6: '2026-13-20T01:00:00.000Z' is no time"));
}

TEST_F(LineTables, PeriodsAreAsManyAsTheChecksAllow) {
  EXPECT_EQ(periods_of(1'000'000, 40), 10);
  EXPECT_EQ(periods_of(1'000'000, 400), 4);
  EXPECT_EQ(periods_of(1'000'000, 1), 24);
  EXPECT_EQ(periods_of(100, 10), 1);
}

}  // namespace
}  // namespace clampd::attribution
