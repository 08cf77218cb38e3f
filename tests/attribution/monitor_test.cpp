#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attribution/monitor_campaign.hpp"
#include "clampd/attribution/line_monitor.hpp"
#include "clampd/views/monitor_view.hpp"

namespace clampd::attribution {
namespace {

using ::testing::HasSubstr;

/// Alarms of a detector that starts anew after each, of readings whose mean and spread it is not told.
template <class Distribution>
int alarms_of(int readings, double threshold, Distribution draw) {
  std::mt19937_64 random(7);
  ChangeDetector detector;
  int alarms = 0;
  for (int i = 0; i < readings; ++i) {
    detector.add(i, 1000.0 + 0.01 * draw(random), 1.0);
    if (detector.evidence() < threshold) continue;
    ++alarms;
    detector = {};
  }
  return alarms;
}

TEST(ChangeDetector, KeepsItsPromiseWithABaselineThatItEstimatesItself) {
  std::normal_distribution<double> normal;
  std::student_t_distribution<double> student(5.0);
  constexpr int kReadings = 30000;
  for (const double threshold : {30.0, 100.0, 300.0}) {
    EXPECT_LE(alarms_of(kReadings, threshold, normal), kReadings / threshold) << threshold;
    EXPECT_LE(alarms_of(kReadings, threshold, student), kReadings / threshold) << threshold;
  }
  EXPECT_GT(alarms_of(kReadings, 30.0, normal), 30) << "it may be silent for another reason than the promise";
}

TEST(ChangeDetector, ExpectsNoMoreThanOneOfEachStartAlsoAfterFewReadings) {
  // After six readings there are four starts. The mean is known to 0.01.
  std::mt19937_64 random(13);
  std::normal_distribution<double> normal;
  constexpr int kSequences = 200000;
  double sum = 0.0;
  for (int sequence = 0; sequence < kSequences; ++sequence) {
    ChangeDetector detector;
    for (int i = 0; i < 6; ++i) detector.add(i, normal(random), 1.0);
    sum += detector.evidence();
  }
  EXPECT_LE(sum / kSequences, 4.03);
  EXPECT_GE(sum / kSequences, 3.5) << "cutting off at 3 costs less than that";
}

TEST(ChangeDetector, CountsAReadingForWhatItIsWorth) {
  // Every tenth reading has three times the spread: said, that is no change.
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  int alarms = 0;
  for (int run = 0; run < 100; ++run) {
    ChangeDetector detector;
    for (int i = 0; i < 100; ++i) {
      const double sd = i % 10 == 9 ? 3.0 : 1.0;
      detector.add(i, sd * normal(random), sd * sd);
    }
    alarms += detector.evidence() > 1000.0 ? 1 : 0;
  }
  EXPECT_LE(alarms, 1);
}

TEST(ChangeDetector, SaysWhenAndByHowMuch) {
  for (const double step : {-2.0, 2.0}) {
    std::mt19937_64 random(11);
    std::normal_distribution<double> normal;
    ChangeDetector detector;
    int raised = -1;
    for (int i = 0; i < 130 && raised < 0; ++i) {
      detector.add(i, 50.0 + normal(random) + (i >= 100 ? step : 0.0), 1.0);
      if (detector.evidence() >= 1e5) raised = i;
    }
    ASSERT_GT(raised, 100);
    EXPECT_LT(raised, 118);
    const ChangeDetector::Change change = detector.change();
    EXPECT_NEAR(change.time_s, 100.0, 3.0);
    EXPECT_NEAR(change.size, step, 4.0 * change.sd);
  }
}

TEST(ChangeDetector, IsNotMovedByOneOddReading) {
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  ChangeDetector detector;
  for (int i = 0; i < 100; ++i) detector.add(i, normal(random), 1.0);
  detector.add(100.0, 1e9, 1.0);
  EXPECT_LT(detector.evidence(), 1000.0);
}

TEST(ChangeDetector, StaysQuietWhereNothingVaries) {
  ChangeDetector detector;
  for (int i = 0; i < 50; ++i) detector.add(i, 12.5, 1.0);
  EXPECT_LE(detector.evidence(), 50.0);
}

/// Days of a line whose stations share each batch; `shift` is what station A has from `changed` on.
struct Days {
  int stations = 4, checks = 8;
  int changed = 1000;
  double shift = 0.0;
  bool master = false;       ///< half of A's checks are of one brake that is far from the others
  bool own_batches = false;  ///< each station has a batch of its own
  std::string part_number = "P";

  LineTable table(int first, int end) const {
    LineTable table;
    table.part_number = part_number;
    table.parameters.push_back({"k2", "N/rad^2", {}, {}});
    for (int s = 0; s < stations; ++s) table.stations.push_back(std::string(1, static_cast<char>('A' + s)));
    for (int day = first; day < end; ++day) {
      std::mt19937_64 random(1000 + static_cast<std::uint64_t>(day));
      std::normal_distribution<double> normal;
      const double shared = 5.0 * normal(random);
      for (int s = 0; s < stations; ++s)
        for (int i = 0; i < checks; ++i) {
          const bool is_master = master && s == 0 && i % 2 == 0;
          table.layout.brake.push_back(static_cast<std::int32_t>(table.brakes.size()));
          table.brakes.push_back(
              is_master ? "master" : std::to_string(day) + "-" + std::to_string(s) + "-" + std::to_string(i));
          table.layout.station.push_back(s);
          table.layout.batch.push_back(own_batches ? s : day / 3);
          table.started_s.push_back(day * kDay_s + 60.0 * (s * checks + i));
          table.parameters[0].values.push_back(50.0 + shared + s +
                                               (is_master ? 20.0 + 0.01 * day : normal(random)) +
                                               (s == 0 && day >= changed ? shift : 0.0));
          table.parameters[0].deviations.push_back(0.1);
        }
    }
    return table;
  }
};

std::string alarms(const LineMonitor& line) {
  std::string names;
  for (std::size_t s = 0; s < line.stations.size(); ++s)
    if (line.parameters.at(0).stations[s].alarm) names += line.stations[s];
  return names;
}

TEST(LineMonitor, NamesTheStationThatChangedAndBeginsAnewWhenItIsMended) {
  Days days;
  days.changed = 60;
  days.shift = 1.5;
  LineMonitor line;
  ASSERT_TRUE(monitor(line, days.table(0, 80)));
  EXPECT_EQ(alarms(line), "A");
  const Alarm alarm = line.parameters[0].stations[0].alarm.value();
  EXPECT_NEAR(alarm.change.time_s / kDay_s, 60.0, 2.0);
  EXPECT_NEAR(alarm.change.size, 1.5, 4.0 * alarm.change.sd);
  EXPECT_THAT(format_monitor(line, {}), HasSubstr("ALARM A/k2"));
  EXPECT_FALSE(acknowledge(line, "B", "k2"));
  EXPECT_FALSE(acknowledge(line, "Z", "k2"));
  ASSERT_TRUE(acknowledge(line, "A", "k2"));
  ASSERT_TRUE(monitor(line, days.table(80, 200)));
  EXPECT_EQ(alarms(line), "") << "the new level is the baseline, and nobody else's readings moved for it";
  days.changed = 200;
  ASSERT_TRUE(monitor(line, days.table(200, 240)));
  EXPECT_EQ(alarms(line), "")
      << "days are held against the level since the acknowledgement: still the same shift";
  days.shift = 3.0;
  ASSERT_TRUE(monitor(line, days.table(240, 280)));
  EXPECT_EQ(alarms(line), "A");
}

TEST(LineMonitor, CountsADayOnceWhateverFilesItComesIn) {
  Days days;
  days.changed = 50;
  days.shift = 0.5;
  LineMonitor at_once, piecewise;
  ASSERT_TRUE(monitor(at_once, days.table(0, 70)));
  for (int end = 1; end <= 70; end += 3) {
    ASSERT_TRUE(monitor(piecewise, days.table(std::max(0, end - 10), end)));
    Result<LineMonitor> read = parse_monitor_state(monitor_state_json(piecewise).dump(), "state.json");
    ASSERT_TRUE(read) << read.error().message;
    piecewise = *read;
  }
  EXPECT_EQ(monitor_state_json(at_once), monitor_state_json(piecewise));
  const auto again = monitor(piecewise, days.table(0, 69));
  ASSERT_TRUE(again);
  EXPECT_EQ(again->counted, 0u);
  EXPECT_EQ(again->before, 69u * 32u);
  EXPECT_EQ(monitor_state_json(at_once), monitor_state_json(piecewise));
}

TEST(LineMonitor, SaysWhichChecksCameTooLate) {
  Days days;
  LineMonitor line;
  LineTable table = days.table(0, 30);
  table.started_s.back() += 2.0 * kDay_s;  // station D's last check makes the other days complete
  ASSERT_TRUE(monitor(line, table));
  LineTable late = days.table(29, 30);
  for (double& started : late.started_s) started += 12.0 * 3600.0;
  const auto count = monitor(line, late);
  ASSERT_TRUE(count);
  EXPECT_EQ(count->late, 32u);
  EXPECT_EQ(count->counted, 0u);
}

TEST(LineMonitor, CountsABrakeThatComesAgainAndAgainOnce) {
  Days days;
  days.master = true;
  LineMonitor line;
  const auto count = monitor(line, days.table(0, 201));
  ASSERT_TRUE(count);
  EXPECT_EQ(count->repeated, 4u * 200u - 1u);
  EXPECT_EQ(alarms(line), "");
}

TEST(LineMonitor, SaysThatNothingCanBeComparedWhereEachStationHasItsOwnBatches) {
  Days days;
  days.own_batches = true;
  LineMonitor line;
  const auto count = monitor(line, days.table(0, 31));
  ASSERT_TRUE(count);
  EXPECT_EQ(count->counted, 0u);
  EXPECT_EQ(count->alone, 30u * 32u);
  EXPECT_THAT(format_monitor(line, *count), HasSubstr("4 not yet watched"));
}

TEST(LineMonitor, RefusesOtherPartsAndParametersAndChangesNothing) {
  Days days;
  LineMonitor line;
  ASSERT_TRUE(monitor(line, days.table(0, 30)));
  const auto before = monitor_state_json(line);
  days.part_number = "Q";
  EXPECT_THAT(monitor(line, days.table(30, 40)).error().message, HasSubstr("part number 'Q'"));
  days.part_number = "P";
  LineTable table = days.table(30, 40);
  table.parameters[0].unit = "kN/rad^2";
  EXPECT_THAT(monitor(line, table).error().message, HasSubstr("parameters or units"));
  EXPECT_EQ(monitor_state_json(line), before);
}

TEST(LineMonitor, RefusesAStateThatItDidNotWrite) {
  LineMonitor line;
  ASSERT_TRUE(monitor(line, Days{}.table(0, 30)));
  const auto good = monitor_state_json(line);
  const auto error = [](const nlohmann::ordered_json& json) {
    const auto read = parse_monitor_state(json.dump(), "state.json");
    return read ? "accepted" : read.error().message;
  };
  EXPECT_EQ(error(good), "accepted");
  const auto with = [&good](const char* pointer, const nlohmann::ordered_json& value) {
    nlohmann::ordered_json changed = good;
    changed[nlohmann::ordered_json::json_pointer(pointer)] = value;
    return changed;
  };
  EXPECT_THAT(error(with("/schema", "clampd.line_monitor_state/2")), HasSubstr("this version reads"));
  for (const auto& [pointer, value] : std::vector<std::pair<const char*, nlohmann::ordered_json>>{
           {"/unknown", 1},
           {"/stations", 7},
           {"/stations", {"A", "B"}},
           {"/false_alarms_per_year", -1.0},
           {"/parameters/0/comparisons/0/1", -3.0},
           {"/parameters/0/stations/0/detector/readings", -1},
           {"/parameters/0/stations/0/detector/readings", 1000000},
           {"/parameters/0/stations/0/detector/squares", "many"},
           {"/parameters/0/stations/0/detector/starts/0", nlohmann::ordered_json::array()},
           {"/parameters/0/stations/0/detector/starts/0/1", 0.0},
           {"/last_day", nullptr}})
    EXPECT_THAT(error(with(pointer, value)), HasSubstr("state.json: is damaged")) << pointer << " " << value;
  const std::string text = good.dump();
  for (std::size_t length = 0; length < text.size(); length += text.size() / 50)
    EXPECT_FALSE(parse_monitor_state(text.substr(0, length), "state.json")) << length;
}

TEST(MonitorCampaign, KeepsThePromiseOnLinesWithoutAChange) {
  int alarms = 0;
  double promised = 0.0;
  for (std::uint64_t seed = 0; seed < 6; ++seed) {
    MonitoredLine line;
    line.noise = seed % 2 == 0 ? Noise::Normal : Noise::StudentFive;
    line.checks_a_day = seed % 3 == 0 ? 3.0 : 12.0;
    line.wander = seed < 3 ? 0.1 : 0.3;
    line.stations = seed == 5 ? 3 : 10;
    line.stations_of_a_batch = seed == 5 ? 3 : 4;
    const FalseAlarms found = count_false_alarms(line, 40 + seed, 10.0);
    alarms += found.alarms;
    promised += found.promised;
  }
  EXPECT_GT(promised, 150.0);
  EXPECT_LE(alarms, promised);
}

TEST(MonitorCampaign, FindsAStepAboutAsSoonAsChartsWithACalibratedLimit) {
  MonitoredLine line;
  line.days = 300;
  line.step = 2.0;
  const Delay delay = measure_delay(line, 9, 20, 10 * 365.25);
  EXPECT_GE(delay.found[0] + delay.early[0], 19);
  EXPECT_LE(delay.early[0], 2);
  EXPECT_LT(delay.mean[0], 3.0 * delay.mean[2]);
}

}  // namespace
}  // namespace clampd::attribution
