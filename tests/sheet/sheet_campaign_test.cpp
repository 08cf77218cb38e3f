// Does the sheet hold what the independent plant does? CLAMPD_SHEET_BRAKES asks for more brakes than the
// quick test has, as does the program sheet_campaign.

#include "tests/sheet/sheet_campaign.hpp"

#include <cstdlib>
#include <iostream>

#include <gtest/gtest.h>

namespace clampd::support {
namespace {

TEST(SheetCampaign, IntervalsHoldWhatThePlantDoes) {
  const char* asked = std::getenv("CLAMPD_SHEET_BRAKES");
  const SheetCampaignOptions options{.brakes = asked ? std::atoi(asked) : 40, .seed = 3, .effect = {}};
  const SheetCampaign campaign = run_sheet_campaign(options);
  print(std::cout, campaign);
  EXPECT_EQ(campaign.not_driven + campaign.not_identified, 0);
  EXPECT_LT(campaign.evaluation_s, 0.5);
  int held = 0, known = 0, decided = 0, decided_wrong = 0;
  for (const CharacteristicCount& count : campaign.characteristics) {
    EXPECT_EQ(count.unknown, 0) << count.name;
    // Four deviations of a share of 95 % around 93 to 97 %.
    const double slack = 4.0 * std::sqrt(0.95 * 0.05 / count.known);
    const double coverage = static_cast<double>(count.held) / count.known;
    EXPECT_GT(coverage, 0.93 - slack) << count.name;
    EXPECT_LT(coverage, 0.97 + slack) << count.name;
    held += count.held;
    known += count.known;
    decided += count.decided;
    decided_wrong += count.decided_wrong;
  }
  EXPECT_LE(decided_wrong, 2 + decided / 1000);
  EXPECT_GT(held, 0.88 * known);
}

// Of a hundred such brakes 99 are marked after six repeats: fewer than 12 of 15 in one set of a hundred
// thousand.
TEST(SheetCampaign, WhatTheModelLacksIsSaid) {
  const SheetCampaign campaign = run_sheet_campaign({.brakes = 15, .seed = 4, .effect = "force-lag=0.001"});
  print(std::cout, campaign);
  EXPECT_GE(campaign.marked, 12);
  EXPECT_EQ(campaign.wrong_without_mark, 0);
}

// A station whose model has the effect has a sheet that is true of it.
TEST(SheetCampaign, WhatTheModelHasIsCounted) {
  const SheetCampaign campaign =
      run_sheet_campaign({.brakes = 40, .seed = 6, .effect = "quadratic-drag=2e-6", .is_known = true});
  print(std::cout, campaign);
  EXPECT_LE(campaign.not_driven + campaign.not_identified, 2);
  int held = 0, known = 0, decided_wrong = 0;
  for (const CharacteristicCount& count : campaign.characteristics) {
    EXPECT_EQ(count.unknown, 0) << count.name;
    held += count.held;
    known += count.known;
    decided_wrong += count.decided_wrong;
  }
  EXPECT_EQ(decided_wrong, 0);
  EXPECT_GT(held, 0.85 * known);
}

}  // namespace
}  // namespace clampd::support
