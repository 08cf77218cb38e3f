#include "tests/drive_bench/judge.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <stdexcept>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "tests/drive_bench/spoil.hpp"

namespace clampd::drive_bench {
namespace {

using Json = nlohmann::json;
using Clock = std::chrono::steady_clock;

std::string text_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// The child may use so much processor time: a busy machine makes no timeout.
pid_t start(const std::vector<std::string>& arguments, const std::string& output, const std::string& errors,
            double limit_s) {
  const pid_t child = fork();
  if (child < 0) throw std::runtime_error("cannot start a process: too many of them?");
  if (child > 0) return child;
  const int out = open(output.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  const int err = open(errors.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  if (out < 0 || err < 0) _exit(127);
  dup2(out, STDOUT_FILENO);
  dup2(err, STDERR_FILENO);
  const auto whole_s = static_cast<rlim_t>(limit_s + 1.0);
  const rlimit limit{whole_s, whole_s};
  setrlimit(RLIMIT_CPU, &limit);
  std::vector<char*> pointers;
  for (const std::string& argument : arguments) pointers.push_back(const_cast<char*>(argument.c_str()));
  pointers.push_back(nullptr);
  execv(pointers.front(), pointers.data());
  _exit(127);
}

double seconds(const timeval& time) {
  return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
}

/// Waits for the child; kills it at the limit of wall time, for one that waits for ever.
void wait_for(pid_t child, double limit_s, Answer& answer) {
  const auto begin = Clock::now();
  const auto elapsed_s = [&] { return std::chrono::duration<double>(Clock::now() - begin).count(); };
  int status = 0;
  rusage usage{};
  pollfd ended{static_cast<int>(syscall(SYS_pidfd_open, child, 0)), POLLIN, 0};
  if (ended.fd < 0) throw std::runtime_error("cannot watch a process: too many open files?");
  for (double left_s = limit_s; left_s > 0.0 && poll(&ended, 1, static_cast<int>(std::ceil(1e3 * left_s))) != 1;)
    left_s = limit_s - elapsed_s();  // a signal ends poll() early
  close(ended.fd);
  answer.timed_out = (ended.revents & POLLIN) == 0;
  if (answer.timed_out) kill(child, SIGKILL);
  wait4(child, &status, 0, &usage);
  answer.wall_s = elapsed_s();
  answer.cpu_s = seconds(usage.ru_utime) + seconds(usage.ru_stime);
  answer.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  answer.timed_out = answer.timed_out || answer.exit_code == -SIGXCPU ||
                     (answer.exit_code == -SIGKILL && answer.cpu_s > limit_s / 20.0);
}

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// Names of column effects carry the column's own name.
std::string canonical(const std::string& name) {
  return name.rfind("column", 0) == 0 ? "column:load" : name;
}

/// Which hidden effects a name stands for, by its own name, the table of twins, or because nobody could tell
/// them apart here.
class Accepted {
 public:
  Accepted(const Score& score, const std::vector<Recording>& runs) : score_(score), runs_(runs) {}

  bool stands_for(const std::string& name, const Hidden& hidden) {
    if (canonical(name) == hidden.name) return true;
    if (in_table(name, hidden.name)) return used_twin_ = true;
    const bool alone = score_.drawn.hidden.size() == 1;
    if (alone && score_.drawn.kind == Kind::Single && is_twin_here(name)) return used_twin_ = true;
    return false;
  }

  bool stands_for_any(const std::string& name) {
    return std::any_of(score_.drawn.hidden.begin(), score_.drawn.hidden.end(),
                       [&](const Hidden& hidden) { return stands_for(name, hidden); });
  }

  bool used_twin() const { return used_twin_; }

 private:
  static bool in_table(const std::string& name, const std::string& hidden) {
    return std::any_of(twins().begin(), twins().end(),
                       [&](const Twin& twin) { return twin.hidden == hidden && twin.named == name; });
  }
  bool is_twin_here(const std::string& name) {
    const Fit fit = fit_named(score_.drawn, runs_, {name});
    return fit.nats < kTwins_nats ||
           (fit.share_left < kTwinsShare && fit.share_left < 0.25 * score_.base.share_left);
  }

  const Score& score_;
  const std::vector<Recording>& runs_;
  bool used_twin_ = false;
};

/// Each name with the rivals of its group: what the answer puts forward. A group counts once.
std::vector<std::vector<std::string>> groups_of(const Answer& answer) {
  std::vector<std::vector<std::string>> groups = answer.rivals;
  for (const std::string& name : answer.effects)
    if (std::none_of(groups.begin(), groups.end(), [&](const auto& group) { return contains(group, name); }))
      groups.push_back({name});
  return groups;
}

/// What the names that were put forward make of a case with something of the list hidden.
Outcome of_names(const Score& score, Accepted& accepted) {
  const Answer& answer = score.answer;
  const auto groups = groups_of(answer);
  std::set<std::size_t> matched;
  bool many = false, missing = false;
  for (std::size_t h = 0; h < score.drawn.hidden.size(); ++h) {
    bool found = false;
    for (std::size_t g = 0; g < groups.size(); ++g) {
      const bool here = std::any_of(groups[g].begin(), groups[g].end(), [&](const std::string& name) {
        return accepted.stands_for(name, score.drawn.hidden[h]);
      });
      if (!here) continue;
      matched.insert(g);
      found = true;
      many = many || groups[g].size() > kMaxRivals;
    }
    missing = missing || (!found && score.detectable[h]);
  }
  if (matched.size() < groups.size()) {
    const bool ambiguous = answer.verdict == "ambiguous";
    if (matched.empty()) return ambiguous ? Outcome::FalseRivals : Outcome::Wrong;
    return Outcome::Extra;
  }
  if (missing) return answer.verdict == "unexplained" ? Outcome::Unexplained : Outcome::Missed;
  return many ? Outcome::ManyRivals : Outcome::Right;
}

bool stopped_for_data(const Answer& answer) {
  return std::any_of(answer.data.begin(), answer.data.end(),
                     [](const Answer::Finding& finding) { return finding.severity == "stop"; });
}

Outcome of_good_data(const Score& score, const std::vector<Recording>& runs, bool& twin) {
  const Answer& answer = score.answer;
  if (answer.exit_code == 2 || stopped_for_data(answer)) return Outcome::Refused;
  Accepted accepted(score, runs);
  const bool claims = answer.verdict == "explained" || answer.verdict == "ambiguous";
  if (score.drawn.kind == Kind::None) {
    if (answer.verdict == "adequate") return Outcome::Right;
    return answer.verdict == "unexplained" ? Outcome::Unexplained
           : answer.verdict == "ambiguous" ? Outcome::FalseRivals
                                           : Outcome::Wrong;
  }
  if (claims ||
      !answer.effects.empty()) {  // effects that are certain may be named beside an unexplained rest
    const Outcome outcome = of_names(score, accepted);
    twin = accepted.used_twin();
    return outcome == Outcome::Right && !claims ? Outcome::Unexplained : outcome;
  }
  // A finding may say what the effect would: the torque's column comes late.
  const bool found = std::any_of(answer.data.begin(), answer.data.end(), [&](const Answer::Finding& finding) {
    return score.drawn.hidden.size() == 1 && accepted.stands_for_any(finding.name);
  });
  if (found && answer.verdict == "adequate") {
    twin = true;
    return Outcome::Right;
  }
  return answer.verdict == "adequate" ? Outcome::Missed : Outcome::Unexplained;
}

Outcome of_bad_data(const Score& score) {
  const Answer& answer = score.answer;
  if (answer.exit_code == 2) return Outcome::Right;
  const auto& names = accepted_findings(score.drawn.spoil);
  const bool found = std::any_of(answer.data.begin(), answer.data.end(), [&](const Answer::Finding& finding) {
    return names.empty() || contains(names, finding.name);
  });
  return found ? Outcome::Right : stopped_for_data(answer) ? Outcome::Right : Outcome::Missed;
}

}  // namespace

std::string_view to_string(Outcome outcome) {
  constexpr const char* kNames[] = {"right",      "many rivals",  "one too many",
                                    "wrong name", "false rivals", "unexplained",
                                    "missed",     "refused",      "failed"};
  return kNames[static_cast<int>(outcome)];
}

bool Score::all_detectable() const {
  return std::all_of(detectable.begin(), detectable.end(), [](bool each) { return each; });
}

const std::vector<Twin>& twins() {
  static const std::vector<Twin> kTwins{
      {"torque-offset", "friction-asymmetry",
       "Coulomb friction that differs by direction is an offset while the drive moves"},
      {"friction-asymmetry", "torque-offset", "the same"},
      {"gravity", "torque-offset", "a vertical axis' gravity is constant"},
      {"gravity", "friction-asymmetry", "a vertical axis' gravity is constant"},
      {"torque-offset", "gravity", "a linear drive cannot tell a weight from an offset"},
      {"torque-lag", "channel-skew", "a lag much faster than the motion is a delay"},
      {"channel-skew", "torque-lag", "the same"},
      {"torque-lag", "torque-delay", "the data finding's name for it"},
      {"channel-skew", "torque-delay", "the data finding's name for it"},
      {"torque-lag", "velocity-delay", "early readings of the motion are late readings of the torque"},
      {"channel-skew", "velocity-delay", "the same"},
      {"channel-skew", "velocity-lag", "the same"},
      {"resonance", "gear-compliance", "two masses on an elastic shaft are just that"},
      {"sticky-place", "friction-position", "friction that is higher at one place depends on the position"},
      {"end-stop", "load-position", "an elastic stop is a load that depends on where the drive is"},
      {"hysteretic-cable", "presliding", "hysteresis over a length is presliding with a long one"},
  };
  return kTwins;
}

Answer parse_answer(const std::string& json_text) {
  Answer answer;
  const Json json = Json::parse(json_text, nullptr, false);
  if (!json.is_object() || !json.contains("verdict") || !json["verdict"].is_string()) return answer;
  try {
    answer.verdict = json["verdict"].get<std::string>();
    for (const Json& effect : json.value("effects", Json::array())) {
      const auto name = effect.at("name").get<std::string>();
      if (!contains(answer.effects, name)) answer.effects.push_back(name);
    }
    answer.rivals = json.value("rivals", std::vector<std::vector<std::string>>{});
    if (json.contains("data") && json["data"].is_array())
      for (const Json& finding : json["data"])
        answer.data.push_back(
            {finding.at("name").get<std::string>(), finding.value("severity", std::string())});
    if (json.contains("share_left") && json["share_left"].is_number())
      answer.share_left = json["share_left"].get<double>();
    answer.readable = true;
  } catch (const Json::exception& problem) {
    answer.messages = problem.what();
  }
  return answer;
}

Answer diagnose(const std::string& program, const Files& files, const std::string& folder, int threads,
                double limit_s) {
  const std::filesystem::path root(folder);
  const std::string json = (root / "diagnosis.json").string(), errors = (root / "stderr.txt").string();
  std::filesystem::remove(json);
  std::vector<std::string> arguments{program, "diagnose"};
  arguments.insert(arguments.end(), files.runs.begin(), files.runs.end());
  arguments.insert(arguments.end(),
                   {"--model", files.model, "--json", json, "--threads", std::to_string(threads)});
  Answer ended;
  wait_for(start(arguments, (root / "stdout.txt").string(), errors, limit_s), 20.0 * limit_s, ended);
  Answer answer = parse_answer(text_of(json));
  answer.exit_code = ended.exit_code;
  answer.timed_out = ended.timed_out;
  answer.cpu_s = ended.cpu_s;
  answer.wall_s = ended.wall_s;
  const std::string messages = text_of(errors);
  answer.messages += messages.substr(messages.size() > 400 ? messages.size() - 400 : 0);
  return answer;
}

void judge_answer(const std::vector<Recording>& runs, Score& score) {
  const Answer& answer = score.answer;
  const bool ended = answer.exit_code == 0 ? answer.readable : answer.exit_code == 2;
  if (!ended || answer.timed_out) {
    score.outcome = Outcome::Failed;
    return;
  }
  if (score.drawn.kind == Kind::BadData) {
    score.outcome = of_bad_data(score);
    return;
  }
  score.outcome = of_good_data(score, runs, score.twin);
  score.least_left = answer.effects.empty() ? score.base.share_left
                                            : fit_named(score.drawn, runs, answer.effects).share_left;
  const bool left = score.least_left > kLeftTooMuch && score.outcome != Outcome::Right;
  score.dishonest = left && answer.verdict == "adequate";
  score.dishonest_explained = left && answer.verdict == "explained";
}

Score judge(std::uint64_t seed, const JudgeOptions& options, const std::string& folder) {
  Score score;
  score.drawn = draw_case(seed, options.effect);
  std::vector<Recording> runs = record_runs(score.drawn);
  score.base = fit_base(score.drawn, runs);
  score.noise_share = noise_share(score.drawn, runs);
  for (std::size_t h = 0; h < score.drawn.hidden.size(); ++h) {
    if (score.drawn.kind == Kind::BadData) break;
    if (score.drawn.kind != Kind::Pair) {
      score.detectable.push_back(is_detectable(score.drawn, score.base));
      continue;
    }
    const Case alone = only(score.drawn, h);
    const std::vector<Recording> of_it = record_runs(alone);
    const bool beside = score.drawn.hidden[h].name == "load-friction";
    score.detectable.push_back(
        is_detectable(alone, beside ? fit_named(alone, of_it, {"gravity"}) : fit_base(alone, of_it)));
  }
  spoil(score.drawn, runs);
  const Files files = write_files(score.drawn, runs, folder, options.all_keys);
  score.answer = diagnose(options.program, files, folder, options.threads, options.limit_s);
  judge_answer(runs, score);
  return score;
}

}  // namespace clampd::drive_bench
