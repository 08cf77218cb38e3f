#include "clampd/reanalysis/task.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "support/shipped_limits.hpp"

namespace clampd::reanalysis {
namespace {

using ::testing::HasSubstr;

Task an_odd_task() {
  Task task;
  task.method = Method::PredictionError;
  task.nominal.theta[0] *= 1.0 / 3.0;
  task.model = ExtendedParameters{task.nominal, {}};
  task.limits = support::shipped_limits();
  task.validity.misfit_max = 0.1 + 0.2;
  task.tare_samples = 321;
  return task;
}

Task a_task_with_a_sheet() {
  Task task = an_odd_task();
  task.model.reset();
  task.sheet = *read_sheet(CLAMPD_SOURCE_DIR "/configs/sheet.toml");
  return task;
}

TEST(Task, ReadsWhatItWrites) {
  const std::string document = format_task(an_odd_task());
  const Result<Task> read = parse_task(document);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->nominal.theta, an_odd_task().nominal.theta);
  EXPECT_EQ(read->method, Method::PredictionError);
  EXPECT_TRUE(read->model.has_value());
  EXPECT_EQ(read->validity.misfit_max, 0.1 + 0.2);
  EXPECT_EQ(read->tare_samples, 321U);
  EXPECT_EQ(read->limits.sha256, an_odd_task().limits.sha256);
  EXPECT_EQ(format_task(*read), document);
}

TEST(Task, HasTheWholeSheetInIt) {
  const std::string document = format_task(a_task_with_a_sheet());
  const Result<Task> read = parse_task(document);
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_TRUE(read->sheet);
  EXPECT_EQ(read->sheet->file, "sheet.toml");
  EXPECT_EQ(read->sheet->sha256, a_task_with_a_sheet().sheet->sha256);
  EXPECT_EQ(read->sheet->characteristics.size(), a_task_with_a_sheet().sheet->characteristics.size());
  EXPECT_EQ(format_task(*read), document);
}

TEST(Task, OfAnEarlierVersionHasNoSheet) {
  nlohmann::ordered_json earlier = nlohmann::ordered_json::parse(format_task(an_odd_task()));
  earlier["schema"] = "clampd.task/1";
  earlier.erase("sheet");
  const Result<Task> read = parse_task(earlier.dump());
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_FALSE(read->sheet);
  EXPECT_EQ(format_task(*read), format_task(an_odd_task()));
}

// So that the same question is answered once, whatever limits the station has.
TEST(Task, OfDiagnosesAndScoresDoesNotDependOnLimits) {
  for (const Task::Kind kind : {Task::Kind::Diagnose, Task::Kind::ScoreEffects}) {
    Task task = an_odd_task();
    task.kind = kind;
    const std::string document = format_task(task);
    const Result<Task> read = parse_task(document);
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->kind, kind);
    EXPECT_EQ(read->nominal.theta, task.nominal.theta);
    task.limits = {};
    task.validity = {};
    EXPECT_EQ(format_task(task), document);
  }
}

TEST(Task, DoesNotDependOnTheFolderOfItsLimits) {
  Task task = an_odd_task();
  task.limits.file = "/somewhere/else/limits.toml";
  EXPECT_EQ(format_task(task), format_task(an_odd_task()));
}

TEST(Task, SaysWhatIsWrong) {
  const auto error = [](const std::string& document) {
    const Result<Task> read = parse_task(document);
    return read ? std::string("none") : read.error().message;
  };
  EXPECT_THAT(error("{"), HasSubstr("cannot be read"));
  EXPECT_THAT(error("[]"), HasSubstr("cannot be read"));
  nlohmann::ordered_json task = nlohmann::ordered_json::parse(format_task(an_odd_task()));
  const auto with = [&](const char* key, const nlohmann::ordered_json& value) {
    nlohmann::ordered_json changed = task;
    changed[key] = value;
    return error(changed.dump());
  };
  EXPECT_THAT(with("kind", "levitate"), HasSubstr("use a newer version"));
  EXPECT_THAT(with("method", "guess"), HasSubstr("known are oem and pem"));
  EXPECT_THAT(with("nominal", "k1 = ["), HasSubstr("nominal brake"));
  EXPECT_THAT(with("limits", {{"file", "my.toml"}, {"text", "revision = 3"}}), HasSubstr("my.toml"));
  EXPECT_THAT(with("validity", nlohmann::ordered_json::object()), HasSubstr("skipped_ticks_max"));
  EXPECT_THAT(with("tare_samples", "many"), HasSubstr("cannot be read"));
  EXPECT_THAT(with("sheet", {{"file", "my.toml"}, {"text", "revision = 3"}}), HasSubstr("my.toml"));
  task["model"] = "[[effect]]\nname = \"backlash\"\nplay = 0.2\n";
  EXPECT_THAT(with("sheet", nlohmann::ordered_json::parse(format_task(a_task_with_a_sheet()))["sheet"]),
              HasSubstr("a sheet cannot count backlash"));
}

}  // namespace
}  // namespace clampd::reanalysis
