// Logs of frames: what is read of them, and what a station would understand.

#include "drivers/can/log.hpp"

#include <algorithm>
#include <array>
#include <random>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "clampd/base/clock.hpp"
#include "drivers/can/brake_codec.hpp"
#include "drivers/can/candump.hpp"
#include "drivers/can/log_check.hpp"

namespace clampd::can {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

FrameLog parsed(const std::string& text) {
  const auto log = parse_log(text, "x.log");
  EXPECT_TRUE(log) << log.error().message;
  return log.value_or(FrameLog{});
}

TEST(FrameLog, ReadsWhatCandumpWrites) {
  const FrameLog log = parsed(
      "(1436509052.249713) vcan0 044#2A366C2BBA\n"
      "(1436509052.449847) vcan0 18FF0001##1000102030405060708090A0B R\n"
      "  can0  0C1   [8]  2E 2D 00 00 00 00 00 00\n"
      " (000.000100)  can0  12345678  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B\r\n"
      " (000.000200)  can0  RX - -  7FF   [0]\n");
  ASSERT_THAT(log.frames, SizeIs(5));
  EXPECT_EQ(log.unreadable, 0U);
  EXPECT_EQ(log.frames[0].frame, (Frame{0x044, 5, {0x2A, 0x36, 0x6C, 0x2B, 0xBA}}));
  EXPECT_NEAR(static_cast<double>(*log.frames[0].time_ns) * 1e-9, 1436509052.249713, 1e-6);
  EXPECT_EQ(log.frames[1].frame.id, kExtendedId | 0x18FF0001);
  EXPECT_EQ(log.frames[1].frame.format, FrameFormat::FdFastData);
  EXPECT_EQ(log.frames[1].frame.size, 12);
  EXPECT_EQ(log.frames[2].frame, (Frame{0x0C1, 8, {0x2E, 0x2D}}));
  EXPECT_FALSE(log.frames[2].time_ns);
  EXPECT_EQ(log.frames[3].frame.format, FrameFormat::Fd);
  EXPECT_EQ(log.frames[3].frame.data[11], 0x0B);
  EXPECT_EQ(log.frames[4].frame.size, 0);
}

TEST(FrameLog, CountsWhatItDoesNotRead) {
  const FrameLog log = parsed(
      "# a comment\n\n(1.0) can0 044#00\n(1.1) can0 044#R\n(1.2) can0 20000080#0000000000000000\nnonsense\n"
      "(1.3) can0 044#0\n(1.3) can0 044#000102030405060708\n(x) can0 044#00\n(1.3) can0 "
      "044##0000102030405060708\n"
      "can0 044 [3] 00 01\n");
  EXPECT_THAT(log.frames, SizeIs(1));
  EXPECT_EQ(log.skipped, 4U);
  EXPECT_EQ(log.unreadable, 6U);
  EXPECT_EQ(log.first_unreadable, 6U);
}

TEST(FrameLog, AFileOfSomethingElseIsRefused) {
  const auto log = parse_log("time,torque\n0.1,0.2\n", "run.csv");
  ASSERT_FALSE(log);
  EXPECT_THAT(log.error().message,
              HasSubstr("run.csv: no CAN frame in its 2 lines, the first of which is \"time,torque\""));
  const auto empty = parse_log("", "empty.log");
  ASSERT_FALSE(empty);
  EXPECT_THAT(empty.error().message,
              HasSubstr("empty.log is empty; record with 'candump -l can0' while the brake sends"));
}

TEST(FrameLog, SurvivesAnything) {
  std::mt19937_64 random{3};
  const std::string letters = "0123456789ABCDEF#()[] .\n\tcan0R_";
  for (int trial = 0; trial < 2000; ++trial) {
    std::string text;
    for (std::size_t i = 0; i < random() % 400; ++i) text += letters[random() % letters.size()];
    for (const LoggedFrame& logged : parse_log(text, "x").value_or(FrameLog{}).frames)
      EXPECT_LE(logged.frame.size, kMaxFrameBytes);
  }
}

class LogCheck : public ::testing::Test {
 protected:
  /// The log of a healthy brake at rest, one sample a millisecond, changed by `change`.
  template <class Change>
  LogFinding check(Change change) const {
    BrakeProtocol brake(codec_);
    FrameLog log;
    std::array<Frame, kMaxFeedbackFrames> frames;
    for (int k = 1; k <= 1000; ++k) {
      BrakeFeedback reading;
      reading.force_N = k;
      reading.brake_time_ns = k * kPeriod_ns;
      const std::size_t count = brake.feedback(reading, frames);
      for (std::size_t i = 0; i < count; ++i) {
        LoggedFrame logged{k * kPeriod_ns + static_cast<std::int64_t>(i) * 150'000, frames[i]};
        if (change(k, i, logged)) log.frames.push_back(logged);
      }
    }
    return check_log(log, database_, mapping_, codec_);
  }
  LogFinding healthy() const {
    return check([](int, std::size_t, LoggedFrame&) { return true; });
  }

  ProtocolMapping mapping_;
  Database database_ = read_dbc(CLAMPD_SOURCE_DIR "/configs/brake.dbc").value();
  ProtocolCodec codec_ = ProtocolCodec::build(database_, mapping_).value();
};

TEST_F(LogCheck, AHealthyBrakeIsUnderstood) {
  const LogFinding finding = healthy();
  EXPECT_THAT(finding.problems, IsEmpty());
  EXPECT_THAT(finding.notes,
              ElementsAre(HasSubstr("BrakeCommand (0x100): not in the log; that is as it should be")));
  EXPECT_EQ(finding.samples, 1000U);
  EXPECT_NEAR(finding.duration_s, 1.0, 2e-3);
  ASSERT_THAT(finding.frames, SizeIs(3));
  const FrameFinding& feedback = finding.frames[1];
  EXPECT_EQ(feedback.good(), 1000U);
  ASSERT_TRUE(feedback.spacing);
  EXPECT_NEAR(feedback.spacing->median_ms, 1.0, 1e-9);
  EXPECT_EQ(feedback.signals.front().name, "force");
  EXPECT_EQ(feedback.signals.front().least, 1.0);
  EXPECT_EQ(feedback.signals.front().most, 1000.0);
}

TEST_F(LogCheck, ARecordsOwnLogIsUnderstood) {
  const CheckRecord record = bench::check(bench::plant(1), 2);
  const auto text = format_candump(record, codec_, "can0");
  ASSERT_TRUE(text);
  const LogFinding finding = check_log(parsed(*text), database_, mapping_, codec_);
  EXPECT_THAT(finding.problems, IsEmpty());
  EXPECT_EQ(finding.samples, record.runs[0].run.size() + record.runs[1].run.size());
}

TEST_F(LogCheck, KnowsABrakeThatIsToldItsSpeed) {
  ProtocolMapping mapping;
  mapping.torque_command = "";
  mapping.velocity_command = "BrakeCommand.VelocityCommand";
  const Database database = read_dbc(CLAMPD_SOURCE_DIR "/tests/support/speed_brake.dbc").value();
  const ProtocolCodec codec = ProtocolCodec::build(database, mapping).value();
  const CheckRecord record = bench::check(bench::plant(1), 2, nullptr, {CommandedQuantity::Velocity});
  const auto text = format_candump(record, codec, "can0");
  ASSERT_TRUE(text);
  const LogFinding finding = check_log(parsed(*text), database, mapping, codec);
  EXPECT_THAT(finding.problems, IsEmpty());
  EXPECT_EQ(finding.samples, record.runs[0].run.size() + record.runs[1].run.size());
  const SignalFinding& command = finding.frames.front().signals.front();
  EXPECT_EQ(command.name, "velocity command");
  EXPECT_EQ(command.unit, "rad/s");
  EXPECT_GT(command.most, 100.0);
}

TEST_F(LogCheck, NamesTheChecksumThatFits) {
  ProtocolMapping other = mapping_;
  other.protection.checksum = Checksum::E2e1a;
  const auto codec = ProtocolCodec::build(database_, other);
  ASSERT_TRUE(codec);
  FrameLog log;
  BrakeProtocol brake(*codec);
  std::array<Frame, kMaxFeedbackFrames> frames;
  for (int k = 1; k <= 100; ++k) {
    BrakeFeedback reading;
    reading.brake_time_ns = k * kPeriod_ns;
    const std::size_t count = brake.feedback(reading, frames);
    for (std::size_t i = 0; i < count; ++i) log.frames.push_back({k * kPeriod_ns, frames[i]});
  }
  const LogFinding finding = check_log(log, database_, mapping_, codec_);
  EXPECT_EQ(finding.samples, 0U);
  EXPECT_THAT(finding.problems,
              ElementsAre(HasSubstr("all are right by [can.protection] checksum = \"e2e-1a\""),
                          HasSubstr("all are right by [can.protection] checksum = \"e2e-1a\"")));
}

TEST_F(LogCheck, SaysWhatIsMissingAndWrong) {
  const auto problems = [&](auto change) { return check(change).problems; };
  EXPECT_THAT(problems([](int, std::size_t i, LoggedFrame&) { return i == 0; }),
              ElementsAre(HasSubstr("BrakeClock (0x181): not in the log; without it no sample is complete")));
  EXPECT_THAT(problems([](int, std::size_t i, LoggedFrame& logged) {
                if (i == 0) logged.frame.size = 7;
                return true;
              }),
              ElementsAre(HasSubstr(
                  "BrakeFeedback (0x180): 1000 of 1000 frames have another size than the 8 bytes of the "
                  "DBC file: 7 bytes (1000 times)")));
  EXPECT_THAT(problems([](int, std::size_t i, LoggedFrame& logged) {
                if (i == 1) logged.frame.format = FrameFormat::Fd;
                return true;
              }),
              ElementsAre(HasSubstr(
                  "BrakeClock (0x181): 1000 of 1000 frames are CAN FD, the DBC file says otherwise")));
  EXPECT_THAT(problems([](int k, std::size_t, LoggedFrame& logged) {
                logged.frame.data[0] ^= k % 50 == 0 ? 1 : 0;
                return true;
              }),
              ElementsAre(HasSubstr("2.0 % of the checksums are wrong; ask the brake's maker"),
                          HasSubstr("2.0 % of the checksums are wrong")));
  EXPECT_THAT(problems([](int, std::size_t, LoggedFrame& logged) {
                *logged.time_ns *= 10;
                return true;
              }),
              ElementsAre(HasSubstr("comes every 10.00 ms; the station needs a sample every 1 ms"),
                          HasSubstr("comes every 10.00 ms")));
}

TEST_F(LogCheck, LostFramesAreANoteAndOthersAreListed) {
  const LogFinding finding = check([](int k, std::size_t i, LoggedFrame& logged) {
    if (k == 500) return false;
    if (k == 700 && i == 0) logged.frame.id = 0x321;
    return true;
  });
  EXPECT_THAT(finding.problems, IsEmpty());
  EXPECT_THAT(finding.notes, Contains(HasSubstr("BrakeFeedback (0x180): its counter jumps 2 times")));
  EXPECT_EQ(finding.samples, 998U);
  EXPECT_EQ(finding.counts.lost_samples, 2U);
  ASSERT_THAT(finding.others, SizeIs(1));
  EXPECT_EQ(finding.others.begin()->first, 0x321U);
}

TEST_F(LogCheck, NotesRangesAndStepsThatChecksDoNotBear) {
  const Demands demands{{-3.0, 3.0, 0.1}, {-350.0, 350.0, 25.0}, {0.0, 0.0, 0.3}, {0.0, 33e3, 2500.0}};
  LogFinding shipped;
  note_demands(codec_, demands, shipped);
  EXPECT_THAT(shipped.notes, IsEmpty());
  Database database = database_;
  for (Message& message : database.messages)
    for (Signal& signal : message.signals) {
      if (signal.name == "TorqueCommand") signal.scale = 0.25;
      if (signal.name == "Velocity") signal.maximum = 300.0;
    }
  LogFinding finding;
  note_demands(ProtocolCodec::build(database, mapping_).value(), demands, finding);
  EXPECT_THAT(
      finding.notes,
      ElementsAre(HasSubstr("torque command: its steps in the DBC file are 0.25 N m, but readings that "
                            "are 0.1 N m apart contradict"),
                  HasSubstr("velocity: the DBC file lets it be -600 to 300 rad/s, less than the -350 "
                            "to 350 rad/s that the station's limits allow")));
}

TEST_F(LogCheck, TellsAMultiplexedMessageOfOtherContentFromOneThatIsNotThere) {
  Database database = database_;
  Message& clock = *std::find_if(database.messages.begin(), database.messages.end(),
                                 [](const Message& message) { return message.name == "BrakeClock"; });
  for (Signal& signal : clock.signals)
    if (signal.name == "SampleClock" || signal.name == "Position") {
      signal.multiplexor = clock.signals.size();
      signal.selected_by = {{3, 3}};
    }
  Signal page;
  page.name = "Page";
  page.start_bit = 64;
  page.bits = 8;
  page.is_multiplexor = true;
  clock.signals.push_back(page);
  clock.size_bytes = 12;
  const ProtocolCodec codec = ProtocolCodec::build(database, mapping_).value();
  FrameLog log;
  Frame frame{0x181, 12, {}};
  frame.format = FrameFormat::Fd;
  frame.data[8] = 2;
  log.frames.push_back({0, frame});
  const LogFinding finding = check_log(log, database, mapping_, codec);
  EXPECT_THAT(finding.frames[2].other_content, 1U);
  EXPECT_THAT(
      finding.problems,
      ElementsAre(HasSubstr("BrakeFeedback (0x180): not in the log"),
                  HasSubstr("BrakeClock (0x181): of 1 frames with its identifier none has 12 bytes")));
}

/// What `can check` says of a log of a brake that sends no clock and samples every 1.01 ms; `change` as
/// above.
template <class Change>
LogFinding check_without_clock(const std::string& counter, Change change) {
  const Database database = read_dbc(CLAMPD_SOURCE_DIR "/configs/brake.dbc").value();
  ProtocolMapping mapping;
  mapping.sample_clock = "";
  if (counter.empty()) mapping.counter.clear();
  const ProtocolCodec codec = ProtocolCodec::build(database, mapping).value();
  BrakeProtocol brake(codec);
  FrameLog log;
  std::array<Frame, kMaxFeedbackFrames> frames;
  for (int k = 1; k <= 1000; ++k) {
    const std::size_t count = brake.feedback({}, frames);
    for (std::size_t i = 0; i < count; ++i) {
      LoggedFrame logged{k * 1'010'000 + static_cast<std::int64_t>(i) * 150'000 + k % 3 * 10'000, frames[i]};
      if (change(k, logged)) log.frames.push_back(logged);
    }
  }
  return check_log(log, database, mapping, codec);
}

TEST(LogCheckWithoutClock, TheArrivalsTellTheTime) {
  for (const char* counter : {"AliveCounter", ""}) {
    const LogFinding finding = check_without_clock(counter, [](int, LoggedFrame&) { return true; });
    EXPECT_THAT(finding.problems, IsEmpty()) << counter;
    EXPECT_GT(finding.samples, 1000U - 2 * ArrivalClock::kSettlingSamples) << counter;
    EXPECT_THAT(finding.notes, Contains(HasSubstr("times are told by the arrivals, which vary by 0.009 ms")));
    const auto unstamped = check_without_clock(counter, [](int, LoggedFrame& logged) {
      logged.time_ns.reset();
      return true;
    });
    EXPECT_THAT(unstamped.problems, Contains(HasSubstr("record it with candump -l"))) << counter;
    const auto slow = check_without_clock(counter, [](int, LoggedFrame& logged) {
      *logged.time_ns *= 2;
      return true;
    });
    EXPECT_THAT(slow.problems, Contains(HasSubstr("no sample has a time: without a sample clock")))
        << counter;
  }
}

TEST(LogCheckWithoutClock, WithoutACounterTheFirstSampleAfterAGapIsLost) {
  const auto gap = [](int k, LoggedFrame&) { return k < 500 || k > 502; };
  const LogFinding counted = check_without_clock("AliveCounter", gap);
  const LogFinding uncounted = check_without_clock("", gap);
  EXPECT_EQ(counted.counts.counter_errors, 0U);
  EXPECT_EQ(uncounted.counts.counter_errors, 0U);
  EXPECT_EQ(uncounted.counts.lost_samples, counted.counts.lost_samples + 1);
  EXPECT_THAT(uncounted.problems, IsEmpty());
  EXPECT_THAT(uncounted.notes, Contains(HasSubstr("neither sample clock nor alive counter")));
  // A gateway that lets go two at once, every now and then: neither is believed.
  const LogFinding held_up = check_without_clock("", [](int k, LoggedFrame& logged) {
    if (k > 200 && k % 20 == 0) *logged.time_ns += 900'000;
    return true;
  });
  EXPECT_EQ(held_up.counts.counter_errors, 0U);
  EXPECT_EQ(held_up.counts.lost_samples, 2U * 40U);
}

TEST(LogCheckWithoutClock, WhatWakesTheBrakeIsNoStrangersFrame) {
  const Database database = read_dbc(CLAMPD_SOURCE_DIR "/tests/hil/guest/brake_fd.dbc").value();
  ProtocolMapping mapping = command_and_feedback_mapping();
  mapping.protection.checksum = Checksum::E2e7;
  mapping.startup = {{"ModeRequest", {{"Mode", 3.0}}, 0.0}};
  const ProtocolCodec codec = ProtocolCodec::build(database, mapping).value();
  FrameLog log;
  log.frames.push_back({0, codec.startup.front().frame});
  log.frames.push_back({1000, Frame{0x7FF, 1, {}}});
  const LogFinding finding = check_log(log, database, mapping, codec);
  ASSERT_THAT(finding.others, SizeIs(1));
  EXPECT_EQ(finding.others.begin()->first, 0x7FFU);
}

}  // namespace
}  // namespace clampd::can
