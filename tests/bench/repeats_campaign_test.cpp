// Whole checks with as many repeats as their brakes need, beside the fixed plan.

#include <cmath>
#include <iostream>

#include <gtest/gtest.h>

#include "tests/bench/repeats_campaign.hpp"

namespace clampd::support {
namespace {

/// So many or more of `trials` with this probability each happen less than once in a thousand times.
int unlikely_count(int trials, double probability) {
  double term = std::pow(1.0 - probability, trials);
  double below = term;
  int count = 0;
  while (1.0 - below > 1e-3) {
    term *= probability / (1.0 - probability) * (trials - count) / (count + 1);
    below += term;
    ++count;
  }
  return count + 1;
}

/// Brakes whose limits are so near that even 20 repeats hardly tell: where it is easiest to be wrong.
TEST(RepeatsCampaign, ErrsNoMoreOftenThanPromisedWhereItIsHardest) {
  RepeatsCampaignOptions options;
  options.brakes = 30;
  options.seed = 7;
  options.near_share = 1.0;
  options.near_sd = 0.5;
  const RepeatsCampaign campaign = run_repeats_campaign(options);
  print(std::cout, campaign);
  const Errors errors = errors_of(campaign, &BrakeResult::automatic, Nearness::Near);
  // A brake that cannot be judged is none that is judged wrongly; the fixed plan has such brakes, too.
  EXPECT_LE(errors.no_verdict, errors_of(campaign, &BrakeResult::fixed, Nearness::Near).no_verdict + 3);
  // Beside the limit that a brake is near there is no other, so that it errs on one side with no more
  // than 2.3 %.
  EXPECT_LT(errors.unmarked_accepts + errors.unmarked_rejects, unlikely_count(errors.checked, 0.02275));
}

TEST(RepeatsCampaign, BrakesOnALineAreCheckedInTime) {
  RepeatsCampaignOptions options;
  options.brakes = 60;
  options.seed = 3;
  const RepeatsCampaign campaign = run_repeats_campaign(options);
  print(std::cout, campaign);
  int in_time = 0, fast = 0;
  for (const BrakeResult& brake : campaign.brakes) {
    fast += brake.automatic.duration_s <= 4.0;
    in_time += brake.automatic.duration_s <= 8.0;
  }
  EXPECT_GT(fast, options.brakes / 2) << "median, bench time";
  // 95 % of all brakes: fewer of these than so many happen less than once in a thousand times.
  EXPECT_LT(options.brakes - in_time, unlikely_count(options.brakes, 0.05));
  for (const Nearness nearness : {Nearness::Far, Nearness::Beyond}) {
    const Errors errors = errors_of(campaign, &BrakeResult::automatic, nearness);
    EXPECT_EQ(errors.wrong_accepts + errors.wrong_rejects, 0);
  }
  EXPECT_EQ(errors_of(campaign, &BrakeResult::automatic, Nearness::Far).no_verdict, 0);
}

}  // namespace
}  // namespace clampd::support
