#include "clampd/archive/json.hpp"

#include <limits>
#include <set>
#include <string>

#include <gtest/gtest.h>

#include "support/check_records.hpp"

namespace clampd {
namespace {

using nlohmann::ordered_json;

TEST(CheckJson, HoldsWhatTheContractPromises) {
  const ordered_json document = check_json(support::make_check_record());
  EXPECT_EQ(document.at("schema"), "clampd.check/1");
  EXPECT_EQ(document.at("serial"), "EMB-0042");
  EXPECT_EQ(document.at("verdict"), "FAIL");
  EXPECT_EQ(document.at("marginal"), false);
  EXPECT_EQ(document.at("reason"), "k2 is 24.64 N/rad^2, below its lower limit 29.92 N/rad^2.");
  EXPECT_EQ(document.at("repeats"), 2);
  EXPECT_TRUE(document.at("stopping").is_null()) << "their number was fixed";
  ASSERT_EQ(document.at("parameters").size(), 7u);
  EXPECT_EQ(document.at("parameters")[1],
            ordered_json::parse(R"({"name":"k2","unit":"N/rad^2","value":24.64,"sd":0.105,
                                    "lower":29.92,"upper":40.48,"verdict":"fail"})"));
  EXPECT_EQ(document.at("parameters")[4].at("verdict"), "marginal");
  const ordered_json& timing = document.at("timing");
  EXPECT_EQ(timing.at("ticks"), 17432);
  EXPECT_EQ(timing.at("skipped"), 1);
  EXPECT_EQ(timing.at("lost_samples"), 2);
  EXPECT_EQ(timing.at("lateness_us"), ordered_json::parse(R"({"min":3.0,"avg":14.2,"max":28.5})"));
  EXPECT_EQ(document.at("tracking_rms_N"), 212.4);
  EXPECT_EQ(document.at("started"), "2026-11-20T23:41:07.123Z");
  EXPECT_EQ(document.at("duration_s"), 17.432);
  EXPECT_TRUE(document.at("cause").is_null());
  EXPECT_EQ(document.at("record"), "20261120T234107123Z-9f3a61c2");
}

TEST(CheckJson, TellsWhatTheSheetSays) {
  CheckRecord record = support::make_check_record();
  EXPECT_TRUE(check_json(record).at("sheet").is_null());
  EXPECT_TRUE(check_json(record).at("recipe").is_null());
  record.recipe = RecipeRecord{"recipes/p-17.toml", "3", std::string(64, 'd')};
  EXPECT_EQ(check_json(record).at("recipe"),
            (ordered_json{{"file", "recipes/p-17.toml"}, {"version", "3"}, {"sha256", std::string(64, 'd')}}));
  record.sheet = support::make_sheet_record();
  const ordered_json sheet = check_json(record).at("sheet");
  EXPECT_EQ(sheet.at("revision"), "4");
  ASSERT_EQ(sheet.at("characteristics").size(), 5u);
  EXPECT_EQ(sheet.at("characteristics")[1],
            ordered_json::parse(
                R"({"name":"stiffness, 20 kN","kind":"stiffness","circumstances":"force_N 20000","unit":"N/rad","value":951.25,"sd":0.6,
                                    "interval_95":[950.074,952.426],"lower":800.0,"upper":1500.0,"verdict":"pass",
                                    "misfit_marked":true,"why":null})"));
  EXPECT_TRUE(sheet.at("characteristics")[0].at("lower").is_null());
  EXPECT_TRUE(sheet.at("characteristics")[2].at("verdict").is_null()) << "it has no limits";
  const ordered_json& unknown = sheet.at("characteristics")[4];
  EXPECT_TRUE(unknown.at("value").is_null() && unknown.at("sd").is_null() && unknown.at("verdict").is_null());
  EXPECT_EQ(unknown.at("why"), "it needs mus, which these runs do not determine");
}

TEST(CheckJson, HoldsTheWholeRecord) {
  const ordered_json document = check_json(support::make_check_record());
  EXPECT_EQ(document.at("operator"), "Jo Müller");
  EXPECT_EQ(document.at("limits").at("revision"), "1");
  EXPECT_EQ(document.at("instruments")[0].at("calibrated"), "2026-05-04");
  EXPECT_EQ(document.at("covariance_normalised").size(), 7u);
  EXPECT_EQ(document.at("covariance_normalised")[6].size(), 7u);
  EXPECT_EQ(document.at("timing").at("lateness_histogram_us"), ordered_json::parse("[[2,7],[4,9]]"));
  ASSERT_EQ(document.at("runs").size(), 2u);
  EXPECT_EQ(document.at("runs")[1].at("tracking_rms_N"), 211.0);
  EXPECT_EQ(document.at("runs")[1].at("converged"), false);
}

TEST(CheckJson, NamesACauseOnlyWhereItIsCertain) {
  CheckRecord record = support::make_check_record();
  record.cause = CauseRecord{"explained", {"force-lag"}, "force-reading", {}, "It comes late."};
  const ordered_json named = check_json(record).at("cause");
  EXPECT_EQ(named.at("effect"), "force-lag");
  EXPECT_EQ(named.at("location"), "force-reading");
  EXPECT_TRUE(named.at("rivals").empty());
  EXPECT_EQ(named.at("summary"), "It comes late.");

  record.cause =
      CauseRecord{"ambiguous", {"force-lag"}, "force-reading", {{"force-lag", "pad-damping"}}, "?"};
  const ordered_json rivals = check_json(record).at("cause");
  EXPECT_TRUE(rivals.at("effect").is_null());
  EXPECT_EQ(rivals.at("rivals"), ordered_json::parse(R"([["force-lag","pad-damping"]])"));

  record.cause = CauseRecord{"unexplained", {}, "", {}, "?"};
  EXPECT_TRUE(check_json(record).at("cause").at("location").is_null());
}

TEST(CheckJson, WritesNoNumberWhereThereIsNone) {
  CheckRecord record = support::make_check_record();
  record.tracking_rms_N = std::numeric_limits<double>::quiet_NaN();
  record.parameters[0].sd = std::numeric_limits<double>::infinity();
  record.covariance_normalised.clear();
  record.instruments = "damaged";
  const ordered_json document = ordered_json::parse(check_json(record).dump());
  EXPECT_TRUE(document.at("tracking_rms_N").is_null());
  EXPECT_TRUE(document.at("parameters")[0].at("sd").is_null());
  EXPECT_TRUE(document.at("covariance_normalised").empty());
  EXPECT_TRUE(document.at("instruments").empty());
}

}  // namespace
}  // namespace clampd
