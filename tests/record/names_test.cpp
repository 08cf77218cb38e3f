#include <set>
#include <string>

#include <gtest/gtest.h>

#include "clampd/record/check_record.hpp"
#include "clampd/record/sample.hpp"

namespace clampd {
namespace {

TEST(Names, EveryEnumeratorHasAnOwnName) {
  std::set<std::string_view> causes;
  for (std::size_t i = 0; i < kFaultCauseCount; ++i) causes.insert(to_string(static_cast<FaultCause>(i)));
  EXPECT_EQ(causes.size(), kFaultCauseCount);
  EXPECT_EQ(causes.count("?"), 0u);

  std::set<std::string_view> phases;
  for (int i = 0; i <= static_cast<int>(CheckPhase::Done); ++i)
    phases.insert(to_string(static_cast<CheckPhase>(i)));
  EXPECT_EQ(phases.size(), static_cast<std::size_t>(CheckPhase::Done) + 1);
  EXPECT_EQ(phases.count("?"), 0u);

  std::set<std::string_view> states;
  for (int i = 0; i <= static_cast<int>(StationState::Fault); ++i)
    states.insert(to_string(static_cast<StationState>(i)));
  EXPECT_EQ(states.size(), static_cast<std::size_t>(StationState::Fault) + 1);
  EXPECT_EQ(states.count("?"), 0u);
}

TEST(Names, VerdictsAreThoseOfTheJsonContract) {
  EXPECT_EQ(to_string(Verdict::Pass), "PASS");
  EXPECT_EQ(to_string(Verdict::Fail), "FAIL");
  EXPECT_EQ(to_string(Verdict::Error), "ERROR");
  EXPECT_EQ(to_string(Verdict::Timeout), "TIMEOUT");
  EXPECT_EQ(to_string(Verdict::Aborted), "ABORTED");
  EXPECT_EQ(to_string(ParameterVerdict::Pass), "pass");
  EXPECT_EQ(to_string(ParameterVerdict::Marginal), "marginal");
  EXPECT_EQ(to_string(ParameterVerdict::Fail), "fail");
}

}  // namespace
}  // namespace clampd
