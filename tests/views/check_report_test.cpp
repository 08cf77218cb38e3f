#include "clampd/views/check_report.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/views/figure.hpp"
#include "support/check_records.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class CheckReport : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const auto drawable = report::can_draw(); !drawable) GTEST_SKIP() << drawable.error().message;
  }
  static std::string page_of(const CheckReportContents& contents) {
    const auto page = check_report(contents);
    EXPECT_TRUE(page) << page.error().message;
    return page.value_or("");
  }
  CheckReportContents contents{support::make_check_record(), {support::make_check_record()}, nullptr, 2.0};
};

TEST_F(CheckReport, ShowsEverythingAndNeedsNothing) {
  Reference reference;
  reference.rows.resize(300);
  contents.reference = &reference;
  CheckRecord before = support::make_check_record("20261119T000000000Z-00000000");
  before.started = "2026-11-19T00:00:00.000Z";
  before.reason = "Better then.";
  contents.history.push_back(before);
  const std::string page = page_of(contents);
  for (const char* expected :
       {"<strong>FAIL</strong>", "banner-bad", "k2 is 24.64 N/rad^2", "EMB-0042", "Jo Müller", "LC-1",
        "calibrated 2026-05-04", "2026-11-20 23:41:07 UTC", "repeat 2", "Better then.",
        "History of this brake", "20261120T234107123Z-9f3a61c2", "SIMULATED BRAKE", "reference", "ticks"})
    EXPECT_THAT(page, HasSubstr(expected));
  for (const char* external : {"src=", "<script", "<link", "@import", "url(http"})
    EXPECT_THAT(page, Not(HasSubstr(external)));
}

TEST_F(CheckReport, ShowsTheGuardBandThatTheVerdictUsed) {
  EXPECT_THAT(page_of(contents), HasSubstr("guard band, 2 standard deviations to either side"));
  contents.check.stopping = StoppingRecord{21, 2.608, "every limit decided after 4 runs"};
  EXPECT_THAT(page_of(contents), HasSubstr("guard band, 2.61 standard deviations to either side"));
}

TEST_F(CheckReport, ShowsTheSheet) {
  EXPECT_THAT(page_of(contents), Not(HasSubstr("95 % interval")));
  contents.check.sheet = support::make_sheet_record();
  const std::string page = page_of(contents);
  for (const char* expected :
       {"95 % interval", "apply-time at force_N 20000", "950.07", "952.43", "not reached", "no limits",
        "not known: it needs mus", "does not explain all of this brake", "revision 4 (configs/sheet.toml)"})
    EXPECT_THAT(page, HasSubstr(expected));
}

TEST_F(CheckReport, AnInvalidCheckSaysSoAndNamesItsCause) {
  contents.check.verdict = Verdict::Error;
  contents.check.cause =
      CauseRecord{"ambiguous", {"force-lag"}, "force-reading", {{"force-lag", "pad-damping"}}, "Late <b>."};
  const std::string page = page_of(contents);
  EXPECT_THAT(page, HasSubstr("banner-mixed"));
  EXPECT_THAT(page, HasSubstr("says nothing about the brake"));
  EXPECT_THAT(page, HasSubstr("Late &lt;b&gt;."));
  EXPECT_THAT(page, HasSubstr("force-lag, pad-damping"));
}

TEST_F(CheckReport, WithoutRawRunsAndWithoutAnything) {
  for (RunRecord& run : contents.check.runs) {
    run.run = {};
    run.removed = "2026-11-21T00:00:00.000Z";
  }
  EXPECT_THAT(page_of(contents), HasSubstr("raw runs were removed on 2026-11-21"));
  CheckRecord nothing;
  nothing.serial = "X";
  nothing.verdict = Verdict::Aborted;
  EXPECT_THAT(page_of({nothing, {}, nullptr, 2.0}), HasSubstr("ABORTED"));
}

}  // namespace
}  // namespace clampd
