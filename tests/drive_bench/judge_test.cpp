// The judge: what counts as named, wrong, honest.

#include "tests/drive_bench/judge.hpp"

#include <gtest/gtest.h>

#include "support/temporary_directory.hpp"

namespace clampd::drive_bench {
namespace {

struct Judged {
  std::vector<Recording> runs;
  Score score;
};

/// A sinusoid with an offset that takes 28 % of the torque, and an answer to it.
Judged judged(Kind kind, const std::string& hidden, const std::string& json, int exit_code = 0) {
  Judged result;
  Case& c = result.score.drawn;
  c.kind = kind;
  c.family = &families().front();
  c.plant.inertia = 0.01;
  c.plant.coulomb = 1.0;
  c.plant.speed = 10.0;
  c.motion = {MotionKind::Sinusoid, 10.0, 0.5, 1e-3, 10.0, 0.0};
  c.rig.torque_limit = 5.0;
  c.rig.bandwidth_rad_s = 100.0;
  c.rig.torque_noise = 0.01;
  if (kind == Kind::Single) c.rig.torque_offset = 0.3;
  if (kind == Kind::Unlisted) c.plant.hidden_load = {0.5, 0.1, 0.4, 0.0, 1.0, 7};
  if (!hidden.empty()) c.hidden = {{hidden, "", {}}};
  if (kind == Kind::BadData) c.spoil = hidden;
  result.runs = record_runs(c);
  result.score.base = fit_base(c, result.runs);
  if (!hidden.empty() && kind != Kind::BadData) result.score.detectable = {true};
  result.score.answer = parse_answer(json);
  result.score.answer.exit_code = exit_code;
  judge_answer(result.runs, result.score);
  return result;
}

std::string answer(const std::string& verdict, const std::string& effects, const std::string& rest = "") {
  return R"({"verdict":")" + verdict + R"(","effects":[)" + effects + "]" + rest + "}";
}
const std::string kOffset = R"({"name":"torque-offset"})", kDrag = R"({"name":"quadratic-drag"})";

Outcome of_single(const std::string& json) {
  return judged(Kind::Single, "torque-offset", json).score.outcome;
}

TEST(Judge, NamesOfASingleEffect) {
  EXPECT_EQ(of_single(answer("explained", kOffset)), Outcome::Right);
  EXPECT_EQ(of_single(answer("explained", R"({"name":"friction-asymmetry"})")), Outcome::Right);  // a twin
  EXPECT_EQ(of_single(answer("explained", kDrag)), Outcome::Wrong);
  EXPECT_EQ(of_single(answer("explained", kOffset + "," + kDrag)), Outcome::Extra);
  EXPECT_EQ(of_single(answer("unexplained", "")), Outcome::Unexplained);
  EXPECT_EQ(of_single(answer("adequate", "")), Outcome::Missed);
}

TEST(Judge, RivalsOfASingleEffect) {
  EXPECT_EQ(of_single(answer("ambiguous", "", R"(,"rivals":[["cogging","torque-offset"]])")), Outcome::Right);
  EXPECT_EQ(of_single(answer("ambiguous", "", R"(,"rivals":[["a","b","c","torque-offset"]])")),
            Outcome::ManyRivals);
  EXPECT_EQ(of_single(answer("ambiguous", "", R"(,"rivals":[["cogging","quadratic-drag"]])")),
            Outcome::FalseRivals);
  EXPECT_EQ(of_single(answer("ambiguous", kDrag, R"(,"rivals":[["cogging","torque-offset"]])")),
            Outcome::Extra);
}

TEST(Judge, NothingHidden) {
  EXPECT_EQ(judged(Kind::None, "", answer("adequate", "")).score.outcome, Outcome::Right);
  EXPECT_EQ(judged(Kind::None, "", answer("explained", kDrag)).score.outcome, Outcome::Wrong);
  EXPECT_EQ(judged(Kind::None, "", answer("unexplained", "")).score.outcome, Outcome::Unexplained);
  EXPECT_EQ(judged(Kind::None, "", "", 2).score.outcome, Outcome::Refused);
  const std::string stop = R"(,"data":[{"name":"jump","severity":"stop"}])";
  EXPECT_EQ(judged(Kind::None, "", answer("unexplained", "", stop)).score.outcome, Outcome::Refused);
}

TEST(Judge, WhatIsOnNoListMayNotBeCalledAdequate) {
  const Judged adequate = judged(Kind::Unlisted, "random-walk-load", answer("adequate", ""));
  EXPECT_TRUE(adequate.score.dishonest);
  const Judged honest = judged(Kind::Unlisted, "random-walk-load", answer("unexplained", ""));
  EXPECT_FALSE(honest.score.dishonest);
  EXPECT_EQ(honest.score.outcome, Outcome::Unexplained);
  const Judged named = judged(Kind::Unlisted, "random-walk-load", answer("explained", kDrag));
  EXPECT_EQ(named.score.outcome, Outcome::Wrong);
  EXPECT_TRUE(named.score.dishonest_explained);
}

TEST(Judge, BadData) {
  const std::string found = R"(,"data":[{"name":"velocity-sign","severity":"mended"}])";
  EXPECT_EQ(judged(Kind::BadData, "velocity-negated", answer("adequate", "", found)).score.outcome,
            Outcome::Right);
  EXPECT_EQ(judged(Kind::BadData, "velocity-negated", answer("adequate", "")).score.outcome, Outcome::Missed);
  EXPECT_EQ(judged(Kind::BadData, "velocity-late", answer("adequate", "", found)).score.outcome,
            Outcome::Missed);
  EXPECT_EQ(judged(Kind::BadData, "cells-nan", "", 2).score.outcome, Outcome::Right);
}

TEST(Judge, WhatIsNoAnswerIsAFailure) {
  EXPECT_EQ(judged(Kind::None, "", "{").score.outcome, Outcome::Failed);
  EXPECT_EQ(judged(Kind::None, "", R"({"verdict":3})").score.outcome, Outcome::Failed);
  EXPECT_EQ(judged(Kind::None, "", R"({"verdict":"explained","effects":[{}]})").score.outcome,
            Outcome::Failed);
  EXPECT_EQ(judged(Kind::None, "", answer("adequate", ""), -11).score.outcome, Outcome::Failed);
  EXPECT_EQ(judged(Kind::None, "", answer("adequate", ""), 1).score.outcome, Outcome::Failed);
}

TEST(Judge, ReadsWhatTheProgramWrites) {
  // One small set the whole way: files in, JSON out. What is found is the bench's business, not this test's.
  JudgeOptions options;
  options.program = CLAMPD_CLAMPCTL;
  options.all_keys = false;
  const support::TemporaryDirectory folder;
  const Score score = judge(265, options, folder.path(""));
  EXPECT_EQ(score.answer.exit_code, 0) << score.answer.messages;
  EXPECT_TRUE(score.answer.readable);
  EXPECT_GT(score.answer.cpu_s, 0.0);
}

TEST(Judge, EndsAProgramThatDoesNotEnd) {
  const support::TemporaryDirectory folder;
  const std::string program = folder.write("endless", "#!/bin/sh\nexec sleep 1000\n");
  std::filesystem::permissions(program, std::filesystem::perms::owner_all);
  const Answer answer = diagnose(program, {{}, "model.toml"}, folder.path(""), 1, 0.05);
  EXPECT_TRUE(answer.timed_out);
  EXPECT_EQ(answer.exit_code, -9);
}

}  // namespace
}  // namespace clampd::drive_bench
