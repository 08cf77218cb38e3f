#include <algorithm>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "clampd/reanalysis/comparison.hpp"
#include "clampd/record/file.hpp"
#include "reanalysis/archive_fixture.hpp"

namespace clampd::reanalysis {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

std::string shipped_sheet() {
  return read_file(CLAMPD_SOURCE_DIR "/configs/sheet.toml").value();
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::string::size_type place = text.find(from);
  EXPECT_NE(place, std::string::npos) << from;
  return text.replace(place, from.size(), to);
}

/// The shipped ones with another upper limit of k2, in N/rad^2.
LimitSet with_upper_k2(double upper) {
  const std::string text =
      replaced(support::shipped_limits().contents, "k2  = {lower = 0.85, upper = 1.15}",
               fmt::format("k2  = {{lower = 0.85, upper = {}}}", upper / nominal_parameters()[k2]));
  return parse_limits(text, "limits.toml").value();
}

constexpr std::uint32_t kMost = 8;

/// Of as many repeats as the brake needs.
CheckRecord automatic_check(int number, const sim::PlantConfiguration& brake, const LimitSet& limits,
                            const std::optional<Sheet>& sheet) {
  bench::PreparedStation prepared = bench::prepared();
  prepared.configuration.check.diagnose = false;
  prepared.configuration.check.repeats_most = kMost;
  prepared.limits = limits;
  prepared.sheet = sheet;
  bench::EmbeddedStation station(std::move(prepared), brake);
  CheckRequest request = bench::request(0);
  request.repeats_auto = true;
  CheckRecord check = station.run_check(request, nullptr, nullptr).value();
  check.id = fmt::format("20261122T{:09}Z-00000000", number);
  check.serial = fmt::format("AUTO-{:04}", number);
  check.started = fmt::format("2026-11-22T08:00:{:02}.000Z", number);
  return check;
}

/// A good brake and one that rubs, by the shipped limits and sheet. Driven once for all tests.
const std::vector<CheckRecord>& automatic_checks() {
  static const std::vector<CheckRecord> kChecks = [] {
    const Sheet sheet = parse_sheet(shipped_sheet(), "sheet.toml").value();
    sim::PlantConfiguration rubbing = bench::plant(12);
    rubbing.brake.theta[TC] *= 2.5;
    return std::vector{automatic_check(1, bench::plant(11), support::shipped_limits(), sheet),
                       automatic_check(2, rubbing, support::shipped_limits(), sheet)};
  }();
  return kChecks;
}

class ArchiveJudging : public support::Archive {
 protected:
  /// What a job says of all checks, by one worker, in the order of the checks.
  std::vector<json> judged(const Task& task) {
    job = submit(task);
    publish::WakeEvent wake;
    const Result<WorkerSummary> summary = work(worker("one"), wake);
    if (!summary) throw std::runtime_error(summary.error().message);
    std::vector<json> documents;
    const std::vector<JobResult> results = jobs().results(job).value();
    for (const JobResult& result : results)
      documents.push_back(result.document.empty() ? json(result.reason) : json::parse(result.document));
    return documents;
  }
  Comparison compared() const {
    const Result<Comparison> comparison = jobs().compared(job, std::nullopt).and_then(compare);
    if (!comparison) throw std::runtime_error(comparison.error().message);
    return *comparison;
  }

  std::int64_t job = 0;
};

TEST_F(ArchiveJudging, OfAnUnchangedTaskIsThatOfTheStation) {
  publish(automatic_checks());
  const std::vector<json> documents = judged(task());
  ASSERT_EQ(documents.size(), automatic_checks().size());
  for (std::size_t i = 0; i < documents.size(); ++i) {
    const CheckRecord& check = automatic_checks()[i];
    const json& found = documents[i];
    ASSERT_TRUE(check.stopping && check.sheet);
    EXPECT_EQ(found["schema"], "clampd.reanalysis/2");
    EXPECT_EQ(found["verdict"], to_string(check.verdict)) << found["reason"];
    EXPECT_EQ(found["marginal"], check.marginal);
    EXPECT_EQ(found["stopping"]["rule"], "auto");
    EXPECT_EQ(found["stopping"]["most"], kMost);
    EXPECT_EQ(found["stopping"]["coverage_factor"], check.stopping->coverage_factor);
    EXPECT_EQ(found["stopping"]["recorded_coverage_factor"], check.stopping->coverage_factor);
    for (std::size_t k = 0; k < check.parameters.size(); ++k)
      EXPECT_EQ(found["parameters"][k]["verdict"], to_string(check.parameters[k].verdict))
          << check.parameters[k].name;
    EXPECT_EQ(found["sheet"]["sha256"], check.sheet->sha256);
    ASSERT_EQ(found["sheet"]["characteristics"].size(), check.sheet->characteristics.size());
    for (std::size_t k = 0; k < check.sheet->characteristics.size(); ++k) {
      const CharacteristicRecord& line = check.sheet->characteristics[k];
      const json& again = found["sheet"]["characteristics"][k];
      EXPECT_EQ(again["name"], line.name);
      EXPECT_EQ(again["circumstances"], line.circumstances);
      EXPECT_EQ(again["value"], line.value) << line.name;
      EXPECT_NEAR(again["sd"], line.sd, 1e-12 * line.sd) << line.name;
      EXPECT_EQ(again["verdict"], line.verdict ? json(to_string(*line.verdict)) : json(nullptr)) << line.name;
    }
  }
  EXPECT_EQ(automatic_checks()[0].verdict, Verdict::Pass);
  EXPECT_EQ(automatic_checks()[1].verdict, Verdict::Fail);
  const Comparison comparison = compared();
  EXPECT_EQ(comparison.checks, 2);
  EXPECT_TRUE(comparison.verdicts.empty());
  EXPECT_TRUE(comparison.lines.empty());
  EXPECT_EQ(comparison.other_guard_bands, 0);
  EXPECT_EQ(comparison.unknown_stopping, 0);
}

/// Guard bands that are wider since runs were chosen, and a misfit that only the repeats of one motion show.
TEST_F(ArchiveJudging, OfRunsAlongSeveralTrajectoriesIsThatOfTheStationToo) {
  sim::PlantConfiguration near = bench::plant(13);
  near.brake.theta[TC] = 0.1526;  // its upper limit is 0.1534
  const CheckRecord check = automatic_check(3, near, support::shipped_limits(), std::nullopt);
  ASSERT_THAT(check.stopping->followed, ::testing::Contains(1));
  publish({check});
  const json found = judged(task()).at(0);
  EXPECT_EQ(found["verdict"], to_string(check.verdict)) << found["reason"];
  EXPECT_EQ(found["marginal"], check.marginal);
  EXPECT_EQ(found["stopping"]["coverage_factor"], check.stopping->coverage_factor);
  EXPECT_EQ(found["systematic_misfit"]["p_value"], check.systematic->p_value);
  for (std::size_t k = 0; k < check.parameters.size(); ++k) {
    EXPECT_EQ(found["parameters"][k]["value"], check.parameters[k].value) << check.parameters[k].name;
    EXPECT_NEAR(found["parameters"][k]["sd"], check.parameters[k].sd, 1e-12) << check.parameters[k].name;
  }
}

/// A limit between the two guard bands: the station looked at it until the most that was allowed.
TEST_F(ArchiveJudging, KeepsAParameterMarginalThatIsSoByTheWiderGuardBand) {
  // Of its noise no look at fewer runs would end the check.
  const sim::PlantConfiguration brake = bench::plant(23);
  // At its limit, so that all repeats are driven; what they come to does not depend on the limit.
  const CheckRecord driven = automatic_check(1, brake, with_upper_k2(brake.brake.theta[k2]), std::nullopt);
  ASSERT_EQ(driven.runs.size(), kMost);
  const ParameterRecord& found = driven.parameters[k2];
  const double between = 0.5 * (support::shipped_limits().guard_band_k + driven.stopping->coverage_factor);
  Task task = Archive::task();
  task.limits = with_upper_k2(found.value + between * found.sd);
  const CheckRecord check = automatic_check(1, brake, task.limits, std::nullopt);
  ASSERT_EQ(check.parameters[k2].verdict, ParameterVerdict::Marginal) << check.stopping->reason;
  CheckRecord fixed = check;
  fixed.id.back() = '1';
  fixed.stopping.reset();

  publish({check, fixed});
  const std::vector<json> documents = judged(task);
  ASSERT_EQ(documents.size(), 2U);
  EXPECT_EQ(documents[0]["parameters"][k2]["verdict"], "marginal");
  EXPECT_EQ(documents[0]["marginal"], true);
  EXPECT_EQ(documents[0]["verdict"], "PASS");
  EXPECT_EQ(documents[1]["parameters"][k2]["verdict"], "pass") << "as of a fixed number of repeats";
  EXPECT_EQ(documents[1]["marginal"], false);
  EXPECT_EQ(documents[1]["stopping"], nullptr);
}

TEST_F(ArchiveJudging, ByAnotherLimitOfTheSheetChangesThatLineAlone) {
  publish(automatic_checks());
  Task stricter = task();
  stricter.sheet =
      parse_sheet(replaced(shipped_sheet(), "upper = 1.40", "upper = 0.10"), "stricter.toml").value();
  const std::vector<json> documents = judged(stricter);
  EXPECT_EQ(documents[0]["sheet"]["file"], "stricter.toml");
  EXPECT_EQ(documents[0]["verdict"], "FAIL");
  EXPECT_THAT(documents[0]["reason"].get<std::string>(), HasSubstr("hysteresis"));
  const Comparison comparison = compared();
  ASSERT_EQ(comparison.lines.size(), 2U);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(comparison.lines[i].serial, automatic_checks()[i].serial);
    EXPECT_EQ(comparison.lines[i].line, "hysteresis at force_N 15000, speed_rad_s 20");
    EXPECT_EQ(comparison.lines[i].before, "pass");
    EXPECT_EQ(comparison.lines[i].after, "fail");
  }
  ASSERT_EQ(comparison.verdicts.size(), 1U) << "the other brake has failed before";
  EXPECT_EQ(comparison.verdicts[0].serial, automatic_checks()[0].serial);
  for (const MovedParameter& moved : comparison.parameters) EXPECT_EQ(moved.largest, 0.0) << moved.name;
}

TEST_F(ArchiveJudging, SaysWhereGuardBandsAreNotThoseOfTheRecord) {
  publish(automatic_checks());
  ask("UPDATE clampd.checks SET stopping = NULL WHERE serial = 'AUTO-0002'");
  Task wider = task();
  wider.limits =
      parse_limits(replaced(support::shipped_limits().contents, "guard_band_k = 2.0", "guard_band_k = 2.5"),
                   "limits.toml")
          .value();
  const std::vector<json> documents = judged(wider);
  EXPECT_GT(documents[0]["stopping"]["coverage_factor"], 2.5);
  EXPECT_EQ(documents[0]["stopping"]["recorded_coverage_factor"],
            automatic_checks()[0].stopping->coverage_factor);
  EXPECT_EQ(documents[1]["stopping"]["rule"], "not on record");
  EXPECT_EQ(compared().other_guard_bands, 1);
  EXPECT_EQ(compared().unknown_stopping, 1);
}

TEST_F(ArchiveJudging, KnowsNoClearanceWhereTheRecordDoesNotSayWhereTheBrakeWasFound) {
  publish(automatic_checks());
  ask("UPDATE clampd.checks SET found_rad = NULL WHERE serial = 'AUTO-0002'");
  Task limited = task();
  limited.sheet =
      parse_sheet("revision = \"1\"\n[[characteristic]]\nkind = \"clearance\"\nunit = \"rad\"\nupper = 9\n",
                  "sheet.toml")
          .value();
  const std::vector<json> documents = judged(limited);
  const json& known = documents[0]["sheet"]["characteristics"][0];
  EXPECT_NEAR(known["value"], 6.0, 4.0 * known["sd"].get<double>()) << "of the simulated brake";
  EXPECT_EQ(known["verdict"], "pass");
  const json& unknown = documents[1]["sheet"]["characteristics"][0];
  EXPECT_TRUE(unknown["value"].is_null());
  EXPECT_THAT(unknown["why"].get<std::string>(),
              HasSubstr("where the check found the brake is not on record"));
  EXPECT_EQ(documents[1]["verdict"], "ERROR");
}

TEST_F(ArchiveJudging, RefusesASheetThatItCannotTell) {
  std::vector<CheckRecord> checks = automatic_checks();
  checks[0].sheet->characteristics.clear();
  checks[1].sheet->characteristics[4].kind = "levitation";
  publish(checks);
  const std::vector<json> documents = judged(task());
  EXPECT_THAT(documents[0].get<std::string>(),
              HasSubstr("the lines of its sheet sheet.toml are not on record"));
  EXPECT_THAT(documents[0].get<std::string>(), HasSubstr("submit the job with --sheet"));
  EXPECT_THAT(documents[1].get<std::string>(), HasSubstr("knows no kind levitation"));

  Task given = task();
  given.sheet = parse_sheet(shipped_sheet(), "sheet.toml").value();
  EXPECT_EQ(judged(given)[0]["verdict"], "PASS");
  Task by_model = task();
  by_model.method = Method::PredictionError;
  by_model.model = ExtendedParameters{by_model.nominal, {}};
  EXPECT_EQ(judged(by_model)[0]["sheet"], nullptr) << "no characteristic counts effects";

  ask("UPDATE clampd.checks SET stopping = jsonb_set(stopping, '{most}', '3')");
  Task again = given;
  again.tare_samples = 499;
  EXPECT_THAT(judged(again)[0].get<std::string>(), HasSubstr("no station looks before 4"));
}

TEST(ArchiveComparison, ReadsWhatEarlierVersionsFound) {
  const std::string earlier =
      R"({"schema":"clampd.reanalysis/1","verdict":"PASS","reason":"","parameters":[{"name":"k2","unit":"N/rad^2","value":30,"sd":1}]})";
  const std::string later =
      R"({"schema":"clampd.reanalysis/2","verdict":"FAIL","reason":"","parameters":[{"name":"k2","unit":"N/rad^2","value":31,"sd":1}],)"
      R"("stopping":{"rule":"auto","most":21,"coverage_factor":2.6,"recorded_coverage_factor":2.6},"sheet":null})";
  const Result<Comparison> comparison = compare({{"check", "EMB-1", later, earlier}});
  ASSERT_TRUE(comparison) << comparison.error().message;
  EXPECT_EQ(comparison->verdicts.size(), 1U);
  EXPECT_EQ(comparison->parameters[0].mean, 1.0);
  EXPECT_TRUE(comparison->lines.empty());
  EXPECT_EQ(comparison->other_guard_bands, 1) << "it knew none but those of the limits";
}

}  // namespace
}  // namespace clampd::reanalysis
