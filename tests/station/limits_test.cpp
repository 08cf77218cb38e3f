#include "clampd/station/limits.hpp"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/record/checksum.hpp"
#include "support/shipped_limits.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

const std::string kGood = R"(revision = "7"
author = "QA"
changed = 2026-11-20
guard_band_k = 1.5
[parameters]
k1 = {lower = -0.5, upper = -0.2}
[parameters_normalised]
k2 = {lower = 0.85, upper = 1.15}
TC = {lower = 0.5, upper = 2}
Ts0 = {lower = 0.5, upper = 2}
Tv = {lower = 0.5, upper = 2}
mus = {lower = 0.5, upper = 2}
ws = {lower = 0.5, upper = 2}
)";

std::string replaced(std::string from, const std::string& to) {
  std::string text = kGood;
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

TEST(Limits, SayWhatChanged) {
  const LimitSet before = *parse_limits(kGood, "limits.toml");
  EXPECT_EQ(before.contents, kGood);
  EXPECT_THAT(changes_between(before, *parse_limits(replaced("\"7\"", "\"8\""), "limits.toml")),
              ::testing::IsEmpty());
  const LimitSet wider = *parse_limits(replaced("lower = 0.85, upper = 1.15", "lower = 0.80, upper = 1.15") +
                                           "[effects.backlash]\nplay = {lower = 0, upper = 0.1}\n",
                                       "limits.toml");
  EXPECT_THAT(changes_between(before, wider),
              ::testing::ElementsAre("k2: lower 29.92 -> 28.16 N/rad^2", "backlash.play: new, 0 to 0.1"));
  EXPECT_THAT(changes_between(wider, before),
              ::testing::ElementsAre("k2: lower 28.16 -> 29.92 N/rad^2", "backlash.play: no longer limited"));
  const LimitSet surer = *parse_limits(replaced("guard_band_k = 1.5", "guard_band_k = 2"), "limits.toml");
  EXPECT_THAT(changes_between(before, surer), ::testing::ElementsAre("guard_band_k: 1.5 -> 2"));
}

TEST(Limits, ReadsSiAndNormalised) {
  const auto limits = parse_limits(kGood, "limits.toml");
  ASSERT_TRUE(limits) << limits.error().message;
  EXPECT_EQ(limits->revision, "7");
  EXPECT_EQ(limits->author, "QA");
  EXPECT_EQ(limits->changed, "2026-11-20");
  EXPECT_EQ(limits->guard_band_k, 1.5);
  EXPECT_EQ(limits->sha256, sha256_hex(kGood));
  EXPECT_EQ(limits->intervals[k1].lower, -0.5);
  EXPECT_EQ(limits->intervals[k1].upper, -0.2);
  EXPECT_DOUBLE_EQ(limits->intervals[k2].lower, 0.85 * 35.2);
}

TEST(Limits, NormalisedLimitsOfANegativeNominalKeepTheirOrder) {
  const auto limits = parse_limits(
      replaced("k1 = {lower = -0.5, upper = -0.2}\n", "") + "k1 = {lower = 0.7, upper = 1.3}\n", "l");
  ASSERT_TRUE(limits) << limits.error().message;
  EXPECT_DOUBLE_EQ(limits->intervals[k1].lower, 1.3 * -0.354);
  EXPECT_DOUBLE_EQ(limits->intervals[k1].upper, 0.7 * -0.354);
}

TEST(Limits, TheShippedSetPassesNominalAndNotASoftCaliper) {
  const LimitSet limits = support::shipped_limits();
  const ParameterVector nominal = nominal_parameters();
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    EXPECT_LT(limits.intervals[i].lower, nominal[static_cast<Eigen::Index>(i)]);
    EXPECT_GT(limits.intervals[i].upper, nominal[static_cast<Eigen::Index>(i)]);
  }
  EXPECT_GT(limits.intervals[k2].lower, 0.75 * nominal[k2]);
}

ExtendedParameters model_of(std::initializer_list<const char*> names) {
  ExtendedParameters model;
  for (const char* name : names) {
    const Effect* effect = find_effect(name);
    model.effects.push_back({effect, std::vector<double>(info_of(*effect).parameters.size(), 0.0)});
  }
  return model;
}

TEST(Limits, OfEffectsNeedAModelThatEstimatesThem) {
  const auto limits =
      parse_limits(kGood + "[effects.backlash]\nplay = {lower = 0.0, upper = 0.3}\n", "l.toml");
  ASSERT_TRUE(limits) << limits.error().message;
  ASSERT_EQ(limits->effects.size(), 1u);
  EXPECT_EQ(limits->effects[0].effect, "backlash");
  EXPECT_EQ(limits->effects[0].parameter, "play");
  EXPECT_EQ(limits->effects[0].interval.upper, 0.3);

  EXPECT_TRUE(check_limits(*limits, model_of({"force-lag", "backlash"})));
  EXPECT_TRUE(check_limits(*parse_limits(kGood, "l.toml"), model_of({"backlash"})));
  const auto lacking = check_limits(*limits, model_of({"force-lag"}));
  ASSERT_FALSE(lacking);
  EXPECT_THAT(lacking.error().message,
              HasSubstr("l.toml: [effects.backlash] has limits, but a check does not"));
  EXPECT_THAT(check_limits(*limits, model_of({"backlash", "backlash"})).error().message,
              HasSubstr("2 times"));
}

struct Refused {
  std::string label;
  std::string from;
  std::string to;
  std::string says;
};
void PrintTo(const Refused& refused, std::ostream* out) {
  *out << refused.label;
}

class LimitsRefuse : public ::testing::TestWithParam<Refused> {};

TEST_P(LimitsRefuse, WithFileAndReason) {
  const auto limits = parse_limits(replaced(GetParam().from, GetParam().to), "limits.toml");
  ASSERT_FALSE(limits);
  EXPECT_THAT(limits.error().message, StartsWith("limits.toml:"));
  EXPECT_THAT(limits.error().message, HasSubstr(GetParam().says));
}

INSTANTIATE_TEST_SUITE_P(
    Impossible, LimitsRefuse,
    ::testing::Values(
        Refused{"swapped", "{lower = 0.85, upper = 1.15}", "{lower = 1.15, upper = 0.85}",
                "8:6: k2: lower 1.15 must be below"},
        Refused{"equal", "{lower = 0.85, upper = 1.15}", "{lower = 1.0, upper = 1.0}", "must be below upper"},
        Refused{"half", "{lower = 0.85, upper = 1.15}", "{lower = 0.85}", "k2 needs both lower and upper"},
        Refused{"not_finite", "upper = 1.15", "upper = inf", "k2.upper = inf is outside"},
        Refused{"not_a_number", "lower = 0.85", "lower = nan", "k2.lower = nan is outside"},
        Refused{"a_text", "lower = 0.85", "lower = \"0.85\"", "must be a number"},
        Refused{"not_exact", "upper = 1.15", "upper = 9007199254740993",
                "8:29: parameters_normalised.k2.upper = 9007199254740993 is too large to be exact"},
        Refused{"normalised_as_si", "[parameters_normalised]\n", "",
                "multiples of the nominal value belong into [parameters_normalised]"},
        Refused{"missing", "Tv = {lower = 0.5, upper = 2}\n", "", "no limits for Tv"},
        Refused{"unknown", "Tv =", "TV =", "unknown key TV in [parameters_normalised]; did you mean Tv?"},
        Refused{"twice", "k2 = {lower = 0.85", "k1 = {lower = 0.5, upper = 2}\nk2 = {lower = 0.85",
                "k1 has limits twice"},
        Refused{"negative_guard", "guard_band_k = 1.5", "guard_band_k = -1.0",
                "guard_band_k = -1 is outside of 0 to 10"},
        Refused{"no_revision", "revision = \"7\"", "", "no revision"},
        Refused{"bad_date", "changed = 2026-11-20", "changed = \"yesterday\"", "YYYY-MM-DD"},
        Refused{"unknown_effect", "[parameters]",
                "[effects.backlsh]\nplay = {lower = 0, upper = 1}\n[parameters]", "did you mean backlash?"},
        Refused{"unknown_effect_parameter", "[parameters]",
                "[effects.backlash]\ngap = {lower = 0, upper = 1}\n[parameters]",
                "unknown key gap in [effects.backlash]; known are play"},
        Refused{"effect_swapped", "[parameters]",
                "[effects.backlash]\nplay = {lower = 1, upper = 0}\n[parameters]",
                "6:8: play: lower 1 must be below upper 0"},
        Refused{"a_choice", "[parameters]",
                "[effects.outliers]\nshare = {lower = 0, upper = 1}\n[parameters]", "chosen, not estimated"},
        Refused{"misspelt", "guard_band_k", "guard_band", "did you mean guard_band_k?"},
        Refused{"not_toml", "[parameters]", "[parameters", "not valid TOML"}),
    [](const auto& input) { return input.param.label; });

}  // namespace
}  // namespace clampd
