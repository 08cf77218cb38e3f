// Do the reported intervals hold the truth, and does a fit that got lost say so? Brakes as wide as the
// paper's Table II, all sensors, starts from the nominal brake. Many more by the program estimation_campaign.

#include "tests/identify/estimation_campaign.hpp"

#include <iostream>

#include <gtest/gtest.h>

namespace clampd::support {
namespace {

/// The rate's interval at 99.9 % overlaps 93 to 97 %: fourteen such comparisons raise a false alarm once in a
/// hundred.
void expect_nominal(const Coverage& coverage, const char* what) {
  constexpr double kWider = 3.29 / 1.96;
  const auto [low, high] = coverage.wilson();
  const double middle = 0.5 * (low + high), half = 0.5 * kWider * (high - low);
  EXPECT_LE(middle - half, 0.97) << what << ": " << coverage.held << " of " << coverage.given;
  EXPECT_GE(middle + half, 0.93) << what << ": " << coverage.held << " of " << coverage.given;
}

Coverage sum_of(const std::array<Coverage, kParameterCount>& table) {
  Coverage sum;
  for (const Coverage& coverage : table) {
    sum.held += coverage.held;
    sum.given += coverage.given;
    sum.unknown += coverage.unknown;
  }
  return sum;
}

Campaign run_and_print(const CampaignOptions& options) {
  const Campaign campaign = run_estimation_campaign(options);
  for (const MethodCampaign& method : campaign.methods)
    for (const std::string& remark : method.remarks) std::cout << remark << '\n';
  print(std::cout, campaign);
  return campaign;
}

TEST(EstimationCampaign, IntervalsHoldTheTruthAndHealthyBrakesGetResults) {
  for (const Bench bench : {Bench::Station, Bench::Reference}) {
    const Campaign campaign = run_and_print(
        {.bench = bench, .checks = 210, .seed = 5, .profiles = 1, .effect = {}, .trajectory = {}});
    for (const MethodCampaign& method : campaign.methods) {
      EXPECT_EQ(method.no_result, 0);
      EXPECT_EQ(method.other_method, 0);
      EXPECT_LE(method.lost, 2) << "one in a thousand is expected, three of 210 once in a thousand seeds";
      EXPECT_GE(method.converged, campaign.checks * 99 / 100);
      for (std::size_t i = 0; i < kParameterCount; ++i)
        expect_nominal(method.by_sd[i], kParameterTable[i].name.data());
      const Coverage profiles = sum_of(method.by_profile);
      expect_nominal(profiles, "profiles");
      EXPECT_LT(profiles.unknown, profiles.given / 20) << "said not to be reliable";
    }
  }
}

TEST(EstimationCampaign, RepeatsAndFarStarts) {
  const Campaign campaign = run_and_print(
      {.checks = 60, .seed = 6, .repeats = 6, .far_starts = true, .effect = {}, .trajectory = {}});
  for (const MethodCampaign& method : campaign.methods) {
    EXPECT_EQ(method.no_result + method.other_method + method.lost, 0);
    EXPECT_EQ(method.converged, campaign.checks);
    for (std::size_t i = 0; i < kParameterCount; ++i)
      expect_nominal(method.by_sd[i], kParameterTable[i].name.data());
  }
}

TEST(EstimationCampaign, SlowSinusoidsGetAnAnswerThatIsTrue) {
  const Campaign campaign = run_and_print(
      {.bench = Bench::Sinusoid, .checks = 15, .seed = 7, .repeats = 2, .effect = {}, .trajectory = {}});
  for (const MethodCampaign& method : campaign.methods) {
    // Output errors of a slow motion under load hold the torque's noise, summed up: about one estimate in fifteen is further from the
    // truth than it says, though its residual is not far enough above the noise for the rule. Prediction errors are not.
    EXPECT_LE(method.lost, &method == &campaign.methods.front() ? 1 : 0);
    EXPECT_EQ(method.no_result, 0);
  }
}

/// Physics that the model lacks, as large as it is on real brakes, is for a diagnosis: it is neither a lost
/// fit nor no result.
TEST(EstimationCampaign, MisfitIsNoLostFit) {
  for (const char* effect : {"force-lag=5e-4", "friction-asymmetry=0.01", "cogging=0.02", "channel-skew=1",
                             "stiffness-hysteresis=0.03", "backlash=0.3"}) {
    std::cout << effect << ":\n";
    const Campaign campaign =
        run_estimation_campaign({.checks = 20, .seed = 8, .effect = effect, .trajectory = {}});
    for (const MethodCampaign& method : campaign.methods)
      EXPECT_EQ(method.no_result + method.other_method, 0) << effect;
  }
}

}  // namespace
}  // namespace clampd::support
