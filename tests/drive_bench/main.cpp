// The blind bench of bare drives: hides an effect, two, none or one that is on no list in run files, or makes
// them bad, has `clampctl diagnose` judge them, and unseals the answer.

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>

#include "clampd/base/version.hpp"
#include "tests/drive_bench/judge.hpp"
#include "tests/drive_bench/spoil.hpp"
#include "tests/support/rate.hpp"

namespace clampd::drive_bench {
namespace {

using support::Rate;
namespace fs = std::filesystem;

struct Options {
  int sets = 400;
  std::uint64_t seed = 1, only = 0;
  std::string half = "both", kind, keep, failures;
  std::vector<std::string> write;
  int threads = 1;
  double minutes = 1e9;
  bool list = false, summary = false;
  JudgeOptions judge;
};

using Condition = std::function<bool(const Score&)>;

Rate rate(const std::vector<Score>& scores, const Condition& among, const Condition& hit) {
  Rate result;
  for (const Score& score : scores)
    if (among(score)) result.add(hit(score));
  return result;
}

void line(const char* what, const Rate& rate, const char* target) {
  fmt::print("  {:<58} {:<34} {}\n", what, rate.text(), target);
}

Condition of_kind(Kind kind) {
  return [=](const Score& score) { return score.drawn.kind == kind; };
}
Condition came_out(std::initializer_list<Outcome> outcomes) {
  return [all = std::set<Outcome>(outcomes)](const Score& score) { return all.contains(score.outcome); };
}
Condition both(Condition a, Condition b) {
  return [=](const Score& score) { return a(score) && b(score); };
}

bool all_detectable(const Score& score) {
  return score.all_detectable();
}
bool is_listed(const Score& score) {
  return score.drawn.kind == Kind::Single || score.drawn.kind == Kind::Pair;
}
bool has_false_name(const Score& score) {
  return score.outcome == Outcome::Wrong || score.outcome == Outcome::Extra;
}

void print_table(const std::vector<Score>& scores) {
  const Condition single = of_kind(Kind::Single), pair = of_kind(Kind::Pair), none = of_kind(Kind::None);
  const Condition unlisted = of_kind(Kind::Unlisted), bad = of_kind(Kind::BadData);
  const Condition wrong = has_false_name, right = came_out({Outcome::Right});
  line("detectable effect: named, or among <= 3 rivals", rate(scores, both(single, all_detectable), right),
       ">= 90 %");
  line("  of these by a twin",
       rate(scores, both(single, all_detectable),
            [](const Score& s) { return s.twin && s.outcome == Outcome::Right; }),
       "");
  line("  unexplained", rate(scores, both(single, all_detectable), came_out({Outcome::Unexplained})), "");
  line("  adequate", rate(scores, both(single, all_detectable), came_out({Outcome::Missed})), "");
  line("  ambiguous without it, or among more",
       rate(scores, both(single, all_detectable), came_out({Outcome::FalseRivals, Outcome::ManyRivals})), "");
  line("  refused", rate(scores, both(single, all_detectable), came_out({Outcome::Refused})), "");
  line("two effects: all detectable ones named",
       rate(scores,
            both(pair,
                 [](const Score& s) {
                   return std::find(s.detectable.begin(), s.detectable.end(), true) != s.detectable.end();
                 }),
            came_out({Outcome::Right, Outcome::Extra, Outcome::ManyRivals})),
       "");
  line("one or two effects, all: a wrong name, or one too many", rate(scores, is_listed, wrong), "<= 3 %");
  line("  a wrong name only", rate(scores, is_listed, came_out({Outcome::Wrong})), "");
  line("no effect: adequate", rate(scores, none, right), ">= 97 %");
  line("  a false name", rate(scores, none, wrong), "");
  line("unlisted: a false name", rate(scores, unlisted, wrong), "<= 5 %");
  line("  false rivals", rate(scores, unlisted, came_out({Outcome::FalseRivals})), "");
  line("  detectable: unexplained or the right kind of thing",
       rate(scores, both(unlisted, all_detectable), came_out({Outcome::Unexplained, Outcome::Right})), "");
  const Condition judged = [](const Score& s) {
    return s.drawn.kind != Kind::BadData && s.outcome != Outcome::Failed;
  };
  line("adequate with more than 10 % of the torque left, coloured",
       rate(scores, judged, [](const Score& s) { return s.dishonest; }), "never");
  line("  explained with as much left",
       rate(scores, judged, [](const Score& s) { return s.dishonest_explained; }), "never");
  line("bad data: the finding, or refused", rate(scores, bad, right), ">= 95 %");
  line(
      "good data: refused",
      rate(
          scores, [](const Score& s) { return s.drawn.kind != Kind::BadData; }, came_out({Outcome::Refused})),
      "0 %");
  line("crash, timeout, unreadable answer",
       rate(
           scores, [](const Score&) { return true; }, came_out({Outcome::Failed})),
       "never");
  std::vector<double> cpu;
  for (const Score& score : scores) cpu.push_back(score.answer.cpu_s);
  std::sort(cpu.begin(), cpu.end());
  if (!cpu.empty())
    fmt::print("  processor seconds a set: median {:.1f}, 90 % {:.1f}, most {:.1f}\n", cpu[cpu.size() / 2],
               cpu[cpu.size() * 9 / 10], cpu.back());
}

std::string hidden_text(const Score& score) {
  if (score.drawn.kind == Kind::None) return "nothing";
  if (score.drawn.kind == Kind::BadData) return "bad data: " + score.drawn.spoil;
  std::vector<std::string> parts;
  for (std::size_t h = 0; h < score.drawn.hidden.size(); ++h) {
    const Hidden& hidden = score.drawn.hidden[h];
    std::string text = hidden.name + (hidden.form.empty() ? "" : "/" + hidden.form);
    for (const auto& [name, value] : hidden.values) text += fmt::format(" {}={:.3g}", name, value);
    parts.push_back(text + (score.detectable[h] ? "" : " (not detectable)"));
  }
  return fmt::format("{}", fmt::join(parts, "; "));
}

std::string answer_text(const Score& score) {
  const Answer& answer = score.answer;
  std::string text = answer.timed_out ? "timeout" : fmt::format("exit {}", answer.exit_code);
  if (answer.readable) text += " " + answer.verdict;
  if (!answer.effects.empty()) text += fmt::format(" {}", fmt::join(answer.effects, " + "));
  for (const auto& group : answer.rivals) text += fmt::format(" [{}]", fmt::join(group, " | "));
  for (const Answer::Finding& finding : answer.data)
    text += fmt::format(" <{} {}>", finding.name, finding.severity);
  if (answer.share_left >= 0.0) text += fmt::format(", says {:.1f} % left", 100.0 * answer.share_left);
  if (answer.exit_code != 0) text += ": " + answer.messages.substr(0, 300);
  return text;
}

bool is_failure(const Score& score) {
  if (score.dishonest || score.dishonest_explained || score.outcome == Outcome::Failed) return true;
  switch (score.drawn.kind) {
    case Kind::None:
    case Kind::BadData:
      return score.outcome != Outcome::Right;
    case Kind::Unlisted:
      return score.outcome != Outcome::Right && score.outcome != Outcome::Unexplained &&
             !(score.outcome == Outcome::Missed && !score.all_detectable());
    default:
      return score.outcome != Outcome::Right &&
             !((score.outcome == Outcome::Missed || score.outcome == Outcome::Unexplained) &&
               !score.all_detectable());
  }
}

std::string describe(const Score& score) {
  std::string text = fmt::format("seed {} ({}): {}\n    hidden: {}\n    {}\n    came out: {}\n",
                                 score.drawn.seed, to_string(score.drawn.kind), to_string(score.outcome),
                                 hidden_text(score), in_words(score.drawn), answer_text(score));
  if (score.drawn.kind != Kind::BadData)
    text += fmt::format(
        "    the best base model leaves {:.1f} % ({:.3g} nats), the best of the named {:.1f} %; noise in the "
        "band {:.1f} %; good enough: {}; {:.1f} s{}{}\n",
        100.0 * score.base.share_left, score.base.nats, 100.0 * score.least_left, 100.0 * score.noise_share,
        score.drawn.good_enough > 0.0 ? fmt::format("{:.1f} %", 100.0 * score.drawn.good_enough) : "not said",
        score.answer.cpu_s, score.twin ? "; by a twin" : "", score.dishonest ? "; MORE THAN 10 % LEFT" : "");
  return text;
}

/// Rows: what is hidden; columns: what came out.
void print_confusion(const std::vector<Score>& scores) {
  std::map<std::string, std::map<std::string, int>> counts;
  std::set<std::string> used;
  for (const Score& score : scores) {
    std::string row = score.drawn.kind == Kind::None   ? "(nothing)"
                      : score.drawn.kind == Kind::Pair ? "(two effects)"
                                                       : score.drawn.hidden.front().name;
    if (score.drawn.kind == Kind::Single && !score.all_detectable()) row = "(not detectable)";
    if (score.drawn.kind == Kind::BadData) row = "bad: " + row;
    const std::string column(to_string(score.outcome));
    ++counts[row][column];
    used.insert(column);
  }
  fmt::print("\n  {:<28}", "hidden");
  for (const std::string& column : used) fmt::print(" {:>13}", column);
  fmt::print("\n");
  for (const auto& [row, cells] : counts) {
    fmt::print("  {:<28}", row);
    for (const std::string& column : used)
      fmt::print(" {:>13}", cells.contains(column) ? fmt::format("{}", cells.at(column)) : ".");
    fmt::print("\n");
  }
}

/// Seeds of a half, in order: those whose family belongs to it.
std::vector<std::uint64_t> seeds_of(bool development, const Options& options) {
  std::vector<std::uint64_t> seeds;
  for (std::uint64_t seed = options.seed; seeds.size() < static_cast<std::size_t>(options.sets); ++seed) {
    const Case drawn = draw_case(seed, options.judge.effect);
    if (drawn.family->development != development) continue;
    if (!options.kind.empty() && options.kind != to_string(drawn.kind)) continue;
    if (!options.judge.effect.empty()) {
      const auto has = [&](const Hidden& h) {
        return h.name == options.judge.effect || h.name + "/" + h.form == options.judge.effect;
      };
      if (std::none_of(drawn.hidden.begin(), drawn.hidden.end(), has)) {
        if (seed > options.seed + 200'000) break;
        continue;
      }
    }
    seeds.push_back(seed);
  }
  return seeds;
}

std::string folder_for(std::uint64_t seed, const Options& options) {
  const fs::path root = options.keep.empty()
                            ? fs::temp_directory_path() / fmt::format("clampd-drive-bench-{}", getpid())
                            : fs::path(options.keep);
  const fs::path folder = root / fmt::format("{}", seed);
  fs::create_directories(folder);
  return folder.string();
}

std::vector<Score> judge_all(const std::vector<std::uint64_t>& seeds, const Options& options) {
  std::vector<Score> scores(seeds.size());
  std::vector<bool> judged(seeds.size(), false);
  std::atomic<std::size_t> next{0}, done{0};
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(60.0 * options.minutes);
  std::mutex mutex;
  const auto work = [&] {
    for (std::size_t i = next++; i < seeds.size(); i = next++) {
      if (std::chrono::steady_clock::now() > end) return;
      const std::string folder = folder_for(seeds[i], options);
      scores[i] = judge(seeds[i], options.judge, folder);
      Score& score = scores[i];
      if (!options.keep.empty() && is_failure(score))
        std::ofstream(fs::path(folder) / "answer.json") << answer_json(score.drawn);
      else
        fs::remove_all(folder);
      const std::lock_guard lock(mutex);
      judged[i] = true;
      if (options.list) fmt::print("{}", describe(score)), std::fflush(stdout);
      if (++done; isatty(STDERR_FILENO)) fmt::print(stderr, "\r{}/{} ", done.load(), seeds.size());
    }
  };
  std::vector<std::thread> workers;
  for (int i = 1; i < options.threads; ++i) workers.emplace_back(work);
  work();
  for (std::thread& worker : workers) worker.join();
  std::vector<Score> finished;
  for (std::size_t i = 0; i < scores.size(); ++i)
    if (judged[i]) finished.push_back(std::move(scores[i]));
  return finished;
}

void report_half(const std::vector<Score>& scores, const char* title, const Options& options,
                 bool aggregate_only) {
  std::set<std::string_view> names;
  for (const Score& score : scores) names.insert(score.drawn.family->name);
  fmt::print("\n{} half, {} sets ({})\n", title, scores.size(), fmt::join(names, ", "));
  print_table(scores);
  if (aggregate_only) return;
  print_confusion(scores);
  std::ofstream file;
  if (!options.failures.empty()) file.open(options.failures, std::ios::app);
  fmt::print("\n  Worst cases of the {} half; write one out with --write SEED DIR\n", title);
  int printed = 0;
  for (const Score& score : scores) {
    if (!is_failure(score)) continue;
    if (file.is_open())
      file << describe(score)
           << (options.keep.empty() ? ""
                                    : fmt::format("    files: {}/{}/\n", options.keep, score.drawn.seed));
    if (++printed <= 25) fmt::print("  {}", describe(score));
  }
  if (printed > 25) fmt::print("  … and {} more\n", printed - 25);
}

int write_set(const Options& options) {
  const std::uint64_t seed = std::stoull(options.write.at(0));
  const std::string& folder = options.write.at(1);
  const Case drawn = draw_case(seed, options.judge.effect);
  std::vector<Recording> runs = record_runs(drawn);
  const Fit base = fit_base(drawn, runs);
  spoil(drawn, runs);
  fs::create_directories(folder);
  const Files files = write_files(drawn, runs, folder, options.judge.all_keys);
  std::ofstream(fs::path(folder) / "answer.json") << answer_json(drawn);
  fmt::print(
      "{}\nThe best base model leaves {:.1f} % of the torque, {:.3g} nats.\nclampctl diagnose {}/run-*.csv "
      "--model {}\n",
      in_words(drawn), 100.0 * base.share_left, base.nats, folder, files.model);
  return 0;
}

/// What the generator draws, without any diagnosis: how many of which kind are detectable, and seconds to
/// make them.
int summarise(const Options& options) {
  std::map<std::string, std::vector<double>> shares;
  for (const bool development : {true, false})
    for (const std::uint64_t seed : seeds_of(development, options)) {
      const Case drawn = draw_case(seed, options.judge.effect);
      const std::vector<Recording> runs = record_runs(drawn);
      const Fit base = fit_base(drawn, runs);
      if (options.list)
        fmt::print("{} {} {} left {:.3f} nats {:.3g} noise {:.3f} rows {}\n  {}\n", seed,
                   to_string(drawn.kind), drawn.hidden.empty() ? "" : drawn.hidden.front().name,
                   base.share_left, base.nats, noise_share(drawn, runs), base.rows, in_words(drawn));
      std::string key =
          fmt::format("{} {}", to_string(drawn.kind),
                      drawn.hidden.empty() || drawn.kind == Kind::BadData || drawn.kind == Kind::Pair
                          ? ""
                          : drawn.hidden.front().name + "/" + drawn.hidden.front().form);
      shares[key].push_back(base.share_left);
    }
  for (auto& [key, values] : shares) {
    std::sort(values.begin(), values.end());
    const auto over = std::count_if(values.begin(), values.end(), [](double v) { return v > 0.075; });
    fmt::print("{:<40} {:4} sets, base model leaves {:5.3f} … {:5.3f} … {:5.3f}; above 7.5 %: {}\n", key,
               values.size(), values.front(), values[values.size() / 2], values.back(), over);
  }
  return 0;
}

/// With a line break, as it prints it.
std::string version_of(const std::string& program) {
  std::string text;
  FILE* const pipe = popen(("'" + program + "' --version").c_str(), "r");
  for (int c = 0; pipe != nullptr && (c = std::fgetc(pipe)) != EOF;) text += static_cast<char>(c);
  if (pipe != nullptr) pclose(pipe);
  return text;
}

int run(int argc, char** argv) {
  CLI::App app{"Blind bench of bare drives: hidden effects and bad data, judged by `clampctl diagnose`"};
  Options options;
  options.judge.program = CLAMPD_CLAMPCTL;
  app.add_option("--sets", options.sets, "sets of each half")->check(CLI::PositiveNumber);
  app.add_option("--seed", options.seed, "of the first set; each set is drawn from its seed alone");
  app.add_option("--half", options.half)->check(CLI::IsMember({"development", "held-out", "both"}));
  app.add_option("--kind", options.kind, "only these sets")
      ->check(CLI::IsMember({"none", "single", "pair", "unlisted", "bad data"}));
  app.add_option("--effect", options.judge.effect,
                 "only sets that hide this one, e.g. cogging or friction-power/below-one");
  app.add_option("--threads", options.threads, "sets at a time, one thread each")->check(CLI::Range(1, 64));
  app.add_option("--minutes", options.minutes, "of each half; then the sets that are done are reported");
  app.add_option("--clampctl", options.judge.program, "the program under test")->check(CLI::ExistingFile);
  app.add_option("--limit", options.judge.limit_s, "processor seconds that a diagnosis may take");
  app.add_option("--keep", options.keep, "folder in which the files of failed sets stay");
  app.add_option("--failures", options.failures,
                 "append each failed set of the development half to this file");
  app.add_option("--write", options.write, "write one set out: SEED DIR")->expected(2);
  app.add_option("--only", options.only, "judge the set of this seed, and say what came out");
  app.add_flag("--list", options.list, "each set as it is done");
  app.add_flag("--summary", options.summary, "what the generator draws, without any diagnosis");
  bool old_keys = false;
  app.add_flag("--old-keys", old_keys,
               "leave good_enough and regressors out of the model files: for programs before them");
  CLI11_PARSE(app, argc, argv);
  options.judge.all_keys = !old_keys;
  if (!options.write.empty()) return write_set(options);
  if (options.summary) return summarise(options);
  if (options.only != 0) {
    fmt::print("{}", describe(judge_all({options.only}, options).front()));
    return 0;
  }
  std::string command;
  for (int i = 0; i < argc; ++i)
    command +=
        fmt::format("{}{}", i > 0 ? " " : "", i == 0 ? fs::path(argv[i]).filename().string() : argv[i]);
  fmt::print("{}; seed {}; bench {}\nprogram under test: {}", command, options.seed, kVersion,
             version_of(options.judge.program));
  std::fflush(stdout);
  for (const bool development : {true, false}) {
    if (options.half == (development ? "held-out" : "development")) continue;
    const std::vector<Score> scores = judge_all(seeds_of(development, options), options);
    report_half(scores, development ? "development" : "held-out", options, !development);
    std::fflush(stdout);
  }
  fs::remove_all(fs::temp_directory_path() / fmt::format("clampd-drive-bench-{}", getpid()));
  return 0;
}

}  // namespace
}  // namespace clampd::drive_bench

int main(int argc, char** argv) {
  try {
    return clampd::drive_bench::run(argc, argv);
  } catch (const std::exception& problem) {
    fmt::print(stderr, "bench_drives: {}\n", problem.what());
    return 2;
  }
}
