#pragma once

#include <string>
#include <vector>

#include "tests/drive_bench/detectability.hpp"
#include "tests/drive_bench/files.hpp"

namespace clampd::drive_bench {

/// What the program under test said of a set: its exit code, its messages and its JSON file, nothing else.
struct Answer {
  int exit_code = -1;  ///< -signal if it was killed
  bool timed_out = false;
  double cpu_s = 0.0, wall_s = 0.0;
  std::string messages;   ///< the end of stderr
  bool readable = false;  ///< there was a JSON document with a verdict
  std::string verdict;
  std::vector<std::string> effects;
  std::vector<std::vector<std::string>> rivals;
  struct Finding {
    std::string name, severity;
  };
  std::vector<Finding> data;
  double share_left = -1.0;
};

/// Runs `PROGRAM diagnose RUNS --model MODEL --json FILE --threads N` to its end, or until it has used
/// `limit_s` of processor time (20 times as much wall time).
Answer diagnose(const std::string& program, const Files& files, const std::string& folder, int threads,
                double limit_s);

/// Reads the document of `diagnose --json`. Unreadable text gives an answer that is not readable.
Answer parse_answer(const std::string& json_text);

enum class Outcome {
  Right,  ///< what is hidden is named, or among at most three rivals; nothing hidden: adequate; bad data:
          ///< found or refused
  ManyRivals,   ///< what is hidden is among more than three
  Extra,        ///< what is hidden is named, and something else besides
  Wrong,        ///< named is something else
  FalseRivals,  ///< ambiguous without what is hidden
  Unexplained,
  Missed,   ///< adequate (bad data: no finding)
  Refused,  ///< an error, or stopped for the data, though the data are good
  Failed,   ///< crash, timeout, unreadable
};
std::string_view to_string(Outcome outcome);

/// A case, what it hides, what came out.
struct Score {
  Case drawn;
  Fit base;
  double noise_share = 0.0;
  std::vector<bool> detectable;  ///< by itself, each hidden effect
  Answer answer;
  Outcome outcome = Outcome::Failed;
  bool twin = false;        ///< right by a twin, not by its own name
  double least_left = 0.0;  ///< share that the best model of the names that came out leaves at least
  bool dishonest = false;   ///< adequate, though more than a tenth of the torque is left and coloured
  bool dishonest_explained = false;  ///< the same of explained

  bool all_detectable() const;
};

/// Names that count as what is hidden, whatever the motion, with the reason: the table of twins.
struct Twin {
  std::string_view hidden, named, why;
};
const std::vector<Twin>& twins();

/// Below this nobody can tell two models apart.
constexpr double kTwins_nats = 10.0;
constexpr double kTwinsShare = 0.01;
constexpr std::size_t kMaxRivals = 3;
constexpr double kLeftTooMuch = 0.10;

/// Draws, records, writes, diagnoses and judges one case in a folder that exists.
struct JudgeOptions {
  std::string program;
  std::string effect;
  int threads = 1;
  double limit_s = 120.0;
  bool all_keys = true;
};
Score judge(std::uint64_t seed, const JudgeOptions& options, const std::string& folder);

/// Judges an answer to a case whose runs are at hand (spoiled or not, the truth in them is what it was).
void judge_answer(const std::vector<Recording>& runs, Score& score);

}  // namespace clampd::drive_bench
