// Blind tests of the diagnosis: sets of run files that hide an effect, or none, or two, or one that is on no
// list. The answers stay sealed until the diagnosis has spoken.

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "clampd/base/version.hpp"
#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/record/file.hpp"
#include "tests/support/blind/detectability.hpp"
#include "tests/support/rate.hpp"

namespace clampd::bench {
namespace {

using support::Rate;
namespace fs = std::filesystem;
using blind::BlindSet;
using blind::Generator;
using blind::HiddenEffect;
using blind::Kind;
using blind::Request;

/// From here on an effect counts as detectable, and one that is on no list as plain.
constexpr double kDetectable_nats = 25.0;
constexpr double kPlain_nats = 300.0;
/// Models closer to each other than this are twins.
constexpr double kTwins_nats = 10.0;
constexpr std::size_t kMaxRivals = 3;
constexpr double kNoiseFloor = 1.1;
constexpr double kStandardDeviations = 3.0;

enum class Outcome {
  Correct,      ///< what is hidden is named (or: nothing is, and the set is adequate), and nothing else
  Rival,        ///< ambiguous, what is hidden among at most three rivals
  ManyRivals,   ///< ambiguous, what is hidden among more
  FalseRivals,  ///< ambiguous without what is hidden
  TwinNamed,    ///< named is a twin of what is hidden
  Extra,        ///< named, or among rivals, is what is hidden, and something else besides
  Wrong,        ///< named is something else
  Unexplained,
  Missed,  ///< called adequate
};
constexpr const char* kOutcomeNames[] = {"correct", "rival", "many rivals", "false rivals", "twin named",
                                         "extra",   "wrong", "unexplained", "missed"};
std::string_view to_string(Outcome outcome) {
  return kOutcomeNames[static_cast<int>(outcome)];
}

struct Options {
  int single = 300, none = 200, offlist = 66, pair = 40;
  int none_feedback = 200, single_feedback = 100;
  int sets = 0;
  std::uint64_t seed = 1;
  std::uint64_t only = 0;
  std::string kind = "single", generator = "both", effect, json, keep;
  bool feedback = false;  ///< of --only
  bool reduced = false, list = false, list_wrong = false;
  unsigned jobs = 0;
};

struct Score {
  Request request;
  std::vector<HiddenEffect> hidden;
  double nats = 0.0;  ///< of a pair: of the weaker one by itself
  /// Between what was named and the truth, if it is wrong.
  double nats_apart = std::numeric_limits<double>::quiet_NaN();
  double explained_nats = 0.0, left_nats = 0.0;  ///< as the diagnosis sees it
  std::string error;
  DiagnosisVerdict verdict = DiagnosisVerdict::Adequate;
  std::vector<std::string> named;
  std::vector<std::vector<std::string>> rivals;
  bool location_right = false;
  Outcome outcome = Outcome::Missed;
  double heldout_misfit = std::numeric_limits<double>::quiet_NaN();
  double worst_parameter_sds = std::numeric_limits<double>::quiet_NaN();
  std::string worst_parameter;
  double least_p_value = 1.0;  ///< of all candidates beside the base model
  double cpu_s = 0.0, wall_s = 0.0;

  bool detectable() const { return request.kind == Kind::None || nats >= kDetectable_nats; }
};

double thread_seconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// Run files of one set, gone when done unless they are to be kept.
class Folder {
 public:
  Folder(const std::string& keep, const Request& request)
      : path_((keep.empty() ? fs::temp_directory_path() : fs::path(keep)) /
              fmt::format("blind-{}-{}-{}{}-{}", keep.empty() ? fmt::format("{}", getpid()) : "set",
                          blind::to_string(request.kind), blind::to_string(request.generator),
                          request.feedback ? "-feedback" : "", request.seed)),
        keep_(!keep.empty()) {}
  ~Folder() {
    std::error_code ignored;
    if (!keep_) fs::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  std::string path() const { return path_.string(); }

 private:
  fs::path path_;
  bool keep_;
};

Result<std::vector<Run>> as_files(const BlindSet& set, const Folder& folder) {
  const auto paths = blind::write_runs(set.runs, folder.path());
  if (!paths) return tl::unexpected(paths.error());
  std::vector<Run> runs;
  for (const std::string& path : *paths) {
    Result<LoadedRun> loaded = read_run(path);
    if (!loaded) return tl::unexpected(loaded.error());
    runs.push_back(std::move(loaded->run));
  }
  return runs;
}

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

/// Each hidden effect must be certain or in a group of rivals of its own, and nothing else be put forward.
Outcome of_ambiguous(const Score& score) {
  std::set<std::size_t> used;
  bool many = false;
  for (const HiddenEffect& effect : score.hidden) {
    bool found = false;
    for (std::size_t group = 0; group < score.rivals.size() && !found; ++group) {
      if (used.contains(group) || !contains(score.rivals[group], effect.name)) continue;
      used.insert(group);
      many = many || score.rivals[group].size() > kMaxRivals;
      found = true;
    }
    if (!found && !contains(score.named, effect.name)) return Outcome::FalseRivals;
  }
  const auto certain = std::count_if(score.named.begin(), score.named.end(), [&](const std::string& name) {
    return std::none_of(score.rivals.begin(), score.rivals.end(),
                        [&](const std::vector<std::string>& group) { return contains(group, name); });
  });
  if (score.rivals.size() + static_cast<std::size_t>(certain) > score.hidden.size()) return Outcome::Extra;
  return many ? Outcome::ManyRivals : Outcome::Rival;
}

Outcome of_explained(const Score& score) {
  const bool all = std::all_of(score.hidden.begin(), score.hidden.end(), [&](const HiddenEffect& effect) {
    return contains(score.named, effect.name);
  });
  if (!all || score.hidden.empty() || score.request.kind == Kind::OffList) return Outcome::Wrong;
  return score.named.size() == score.hidden.size() ? Outcome::Correct : Outcome::Extra;
}

Outcome judge(const Score& score) {
  switch (score.verdict) {
    case DiagnosisVerdict::Adequate:
      return score.request.kind == Kind::None ? Outcome::Correct : Outcome::Missed;
    case DiagnosisVerdict::Unexplained:
      return Outcome::Unexplained;
    case DiagnosisVerdict::Ambiguous:
      return of_ambiguous(score);
    case DiagnosisVerdict::Explained:
      return of_explained(score);
  }
  return Outcome::Wrong;
}

void judge_parameters(const Diagnosis& diagnosis, const BrakeParameters& truth, Score& score) {
  score.worst_parameter_sds = 0.0;
  for (const EstimatedParameter& parameter : diagnosis.parameters_after) {
    const auto index = find_parameter(parameter.name);
    if (!index) continue;
    const double sds =
        std::abs(parameter.value - truth.theta[static_cast<Eigen::Index>(*index)]) / parameter.sd;
    if (sds <= score.worst_parameter_sds) continue;
    score.worst_parameter_sds = std::isfinite(sds) ? sds : 1e9;
    score.worst_parameter = parameter.name;
  }
}

double weakest_nats(const BlindSet& set) {
  if (set.answer.effects.size() < 2) return blind::detectability_nats(set);
  double least = std::numeric_limits<double>::infinity();
  for (const HiddenEffect& effect : set.answer.effects) {
    blind::Answer alone = set.answer;
    alone.effects = {effect};
    const Result<BlindSet> weaker = blind::simulate(alone);
    if (weaker) least = std::min(least, blind::detectability_nats(*weaker));
  }
  return least;
}

Score diagnose_one(const Request& request, const Options& options, Diagnosis* details = nullptr) {
  Score score;
  score.request = request;
  const Result<BlindSet> set = blind::make_set(request);
  if (!set) {
    score.error = set.error().message;
    return score;
  }
  const Folder folder(options.keep, request);
  const Result<std::vector<Run>> runs = as_files(*set, folder);
  if (!runs) {
    score.error = runs.error().message;
    return score;
  }
  DiagnoseOptions diagnose_options;
  diagnose_options.threads = 1;
  const double start_s = thread_seconds();
  Result<Diagnosis> diagnosis = diagnose(*runs, diagnose_options);
  score.cpu_s = thread_seconds() - start_s;

  // Unsealed.
  score.hidden = set->answer.effects;
  score.nats = request.kind == Kind::None ? 0.0 : weakest_nats(*set);
  if (!diagnosis) {
    score.error = diagnosis.error().message;
    return score;
  }
  score.wall_s = diagnosis->wall_s;
  score.verdict = diagnosis->verdict;
  score.rivals = diagnosis->rivals;
  const std::vector<std::string> no_locations;
  const auto& locations = score.hidden.empty() ? no_locations : score.hidden.front().locations;
  for (const NamedEffect& effect : diagnosis->effects) {
    if (!contains(score.named, effect.name)) score.named.push_back(effect.name);  // harmonics are one effect
    score.location_right =
        score.location_right || contains(locations, std::string(to_string(effect.location)));
  }
  if (score.verdict == DiagnosisVerdict::Unexplained && diagnosis->misfit.location)
    score.location_right = contains(locations, std::string(to_string(*diagnosis->misfit.location)));
  score.outcome = judge(score);
  if (request.kind == Kind::Single && score.outcome == Outcome::Wrong) {
    score.nats_apart = blind::nats_left(*set, diagnosis->model);
    if (score.nats_apart < kTwins_nats) score.outcome = Outcome::TwinNamed;
  }
  for (const CandidateSummary& summary : diagnosis->candidates)
    if (summary.stage == 1) score.least_p_value = std::min(score.least_p_value, summary.p_value);
  score.explained_nats = diagnosis->misfit.explained_nats;
  score.left_nats = diagnosis->misfit.left_nats;
  if (diagnosis->gain) score.heldout_misfit = diagnosis->gain->after.misfit;
  judge_parameters(*diagnosis, set->answer.brake, score);
  if (details != nullptr) *details = std::move(*diagnosis);
  return score;
}

template <class Filter, class Hit>
Rate share(const std::vector<Score>& scores, Filter filter, Hit hit) {
  Rate result;
  for (const Score& score : scores)
    if (score.error.empty() && filter(score)) result.add(hit(score));
  return result;
}

void line(const char* what, const Rate& share, const char* target) {
  fmt::print("  {:<46} {:<32} {}\n", what, share.text(), target);
}

template <class Filter>
void print_singles(const std::vector<Score>& scores, const char* title, Filter chosen) {
  const auto in = [&](const Score& s) { return s.request.kind == Kind::Single && chosen(s); };
  const auto detectable = [&](const Score& s) { return in(s) && s.detectable(); };
  const auto is = [](std::initializer_list<Outcome> outcomes) {
    return [all = std::vector<Outcome>(outcomes)](const Score& s) {
      return std::find(all.begin(), all.end(), s.outcome) != all.end();
    };
  };
  if (share(scores, in, is({})).of == 0) return;
  fmt::print("\nOne effect of the list, {}\n", title);
  line("detectable: named rightly, or among <= 3 rivals",
       share(scores, detectable, is({Outcome::Correct, Outcome::Rival})), ">= 95 %");
  line("  named rightly", share(scores, detectable, is({Outcome::Correct})), "");
  line("  rival", share(scores, detectable, is({Outcome::Rival})), "");
  line("  unexplained", share(scores, detectable, is({Outcome::Unexplained})), "");
  line("  missed", share(scores, detectable, is({Outcome::Missed})), "");
  line("all: ambiguous", share(scores, in, is({Outcome::Rival, Outcome::ManyRivals, Outcome::FalseRivals})),
       "<= 25 %");
  line("  more than three rivals", share(scores, in, is({Outcome::ManyRivals})), "");
  line("  the truth not among the rivals", share(scores, in, is({Outcome::FalseRivals})), "");
  line("all: wrong name", share(scores, in, is({Outcome::Wrong, Outcome::Extra, Outcome::TwinNamed})),
       "<= 3 %");
  line("  a twin (less than 10 nats apart)", share(scores, in, is({Outcome::TwinNamed})), "");
  line("  one too many", share(scores, in, is({Outcome::Extra})), "");
  const auto named = [&](const Score& s) { return detectable(s) && s.outcome == Outcome::Correct; };
  line("named: held-out misfit <= 1.1 of the floor",
       share(
           scores, [&](const Score& s) { return named(s) && std::isfinite(s.heldout_misfit); },
           [](const Score& s) { return s.heldout_misfit <= kNoiseFloor; }),
       "");
  line("named: all seven parameters within 3 sd",
       share(scores, named, [](const Score& s) { return s.worst_parameter_sds <= kStandardDeviations; }),
       ">= 95 %");
}

void print_nones(const std::vector<Score>& scores, const char* title, bool feedback, const char* target) {
  const auto in = [=](const Score& s) {
    return s.request.kind == Kind::None && s.request.feedback == feedback;
  };
  if (std::none_of(scores.begin(), scores.end(), in)) return;
  fmt::print("\n{}\n", title);
  line("adequate", share(scores, in, [](const Score& s) { return s.verdict == DiagnosisVerdict::Adequate; }),
       target);
  for (const double level : {0.5, 0.2, 0.05})
    line(fmt::format("least p-value of the candidates below {:g}", level).c_str(),
         share(scores, in, [=](const Score& s) { return s.least_p_value < level; }),
         fmt::format("{:g} %", 100.0 * level).c_str());
  line("all seven parameters within 3 sd",
       share(scores, in, [](const Score& s) { return s.worst_parameter_sds <= kStandardDeviations; }), "");
}

void print_others(const std::vector<Score>& scores) {
  const auto of_kind = [](Kind kind, double least_nats = -1.0) {
    return [=](const Score& s) { return s.request.kind == kind && s.nats > least_nats; };
  };
  const auto verdict = [](DiagnosisVerdict which) {
    return [=](const Score& s) { return s.verdict == which; };
  };
  print_nones(scores, "No effect", false, ">= 97 %");
  print_nones(scores, "No effect, feedback in the row", true, ">= 98 %");
  if (std::any_of(scores.begin(), scores.end(), of_kind(Kind::OffList))) {
    fmt::print("\nOne effect that is not on the list\n");
    line("a false name", share(scores, of_kind(Kind::OffList), verdict(DiagnosisVerdict::Explained)),
         "<= 10 %");
    line("false rivals", share(scores, of_kind(Kind::OffList), verdict(DiagnosisVerdict::Ambiguous)), "");
    const auto plain = of_kind(Kind::OffList, kPlain_nats);
    line("above 300 nats: unexplained or the right place",
         share(scores, plain,
               [](const Score& s) { return s.verdict == DiagnosisVerdict::Unexplained || s.location_right; }),
         ">= 90 %");
    line("  unexplained", share(scores, plain, verdict(DiagnosisVerdict::Unexplained)), "");
    line("  a false name", share(scores, plain, verdict(DiagnosisVerdict::Explained)), "");
  }
  if (std::any_of(scores.begin(), scores.end(), of_kind(Kind::Pair))) {
    fmt::print("\nTwo effects at once\n");
    const auto both = [](const Score& s) {
      return s.outcome == Outcome::Correct || s.outcome == Outcome::Extra || s.outcome == Outcome::Rival;
    };
    line("each detectable: both found",
         share(
             scores, [](const Score& s) { return s.request.kind == Kind::Pair && s.detectable(); }, both),
         ">= 80 %");
    line("all: both found", share(scores, of_kind(Kind::Pair), both), "");
    line("all: one too many",
         share(scores, of_kind(Kind::Pair), [](const Score& s) { return s.outcome == Outcome::Extra; }), "");
  }
}

std::string row_of(const Score& score) {
  if (score.hidden.empty()) return "none";
  if (score.hidden.size() > 1) return "two effects";
  return score.hidden.front().name;
}

/// What the set was taken for.
std::string column_of(const Score& score) {
  if (!score.error.empty()) return "(error)";
  switch (score.verdict) {
    case DiagnosisVerdict::Adequate:
      return "adequate";
    case DiagnosisVerdict::Unexplained:
      return "unexplained";
    case DiagnosisVerdict::Ambiguous:
      return score.outcome == Outcome::Rival || score.outcome == Outcome::ManyRivals ? "right rivals"
                                                                                     : "false rivals";
    case DiagnosisVerdict::Explained:
      return score.named.size() == 1 ? score.named.front() : "several";
  }
  return {};
}

void print_confusion(const std::vector<Score>& scores) {
  std::vector<std::string> rows;
  for (const bool on_list : {true, false})
    for (const std::string_view name : blind::effect_names(on_list, Generator::Independent))
      rows.emplace_back(name);
  rows.insert(rows.end(), {"none", "two effects"});
  std::vector<std::string> columns = rows;
  columns.insert(columns.end(),
                 {"several", "right rivals", "false rivals", "unexplained", "adequate", "(error)"});
  std::map<std::string, std::map<std::string, int>> counts;
  std::set<std::string> used;
  for (const Score& score : scores) {
    if (score.error.empty() && !score.detectable()) continue;
    ++counts[row_of(score)][column_of(score)];
    used.insert(column_of(score));
  }
  std::erase_if(columns, [&](const std::string& column) { return !used.contains(column); });
  fmt::print("\nDetectable sets; rows: hidden, columns: the answer\n");
  for (std::size_t i = 0; i < columns.size(); ++i)
    fmt::print("{}{:3} {:<21}", i % 4 == 0 ? "\n" : "", i + 1, columns[i]);
  fmt::print("\n\n{:<22}", "");
  for (std::size_t i = 0; i < columns.size(); ++i) fmt::print("{:4}", i + 1);
  fmt::print("\n");
  for (const std::string& row : rows) {
    if (!counts.contains(row)) continue;
    fmt::print("{:<22}", row);
    for (const std::string& column : columns) {
      const int count = counts[row][column];
      fmt::print("{:>4}", count == 0 ? "." : fmt::format("{}", count));
    }
    fmt::print("\n");
  }
}

std::string describe(const Score& score) {
  std::vector<std::string> hidden;
  for (const HiddenEffect& effect : score.hidden) {
    std::string values;
    for (const auto& [name, value] : effect.values) values += fmt::format(" {}={:.3g}", name, value);
    hidden.push_back(fmt::format("{} ({}{})", effect.name, effect.form, values));
  }
  std::string answer = score.error.empty() ? std::string(to_string(score.verdict)) : "error: " + score.error;
  if (!score.named.empty()) answer += fmt::format(" {}", fmt::join(score.named, " + "));
  for (const auto& group : score.rivals) answer += fmt::format(" [{}]", fmt::join(group, " | "));
  std::string text =
      fmt::format("{} {} seed {}: {:.0f} nats, hidden: {}; answer: {} ({})",
                  blind::to_string(score.request.kind), blind::to_string(score.request.generator),
                  score.request.seed, score.nats, fmt::join(hidden, ", "), answer, to_string(score.outcome));
  if (std::isfinite(score.nats_apart)) text += fmt::format(", {:.0f} nats apart", score.nats_apart);
  if (score.worst_parameter_sds > kStandardDeviations)
    text += fmt::format(", {} {:.1f} sd off", score.worst_parameter, score.worst_parameter_sds);
  if (score.heldout_misfit > kNoiseFloor)
    text += fmt::format(", held-out misfit {:.2f}", score.heldout_misfit);
  text += fmt::format(", {:.1f} s", score.cpu_s);
  return text;
}

bool is_failure(const Score& score) {
  if (!score.error.empty()) return true;
  if (score.request.kind == Kind::OffList)
    return score.verdict == DiagnosisVerdict::Explained || score.verdict == DiagnosisVerdict::Ambiguous ||
           (score.nats > kPlain_nats && score.verdict == DiagnosisVerdict::Adequate);
  if (score.outcome == Outcome::Correct || score.outcome == Outcome::Rival)
    return score.outcome == Outcome::Correct && score.detectable() &&
           (score.worst_parameter_sds > kStandardDeviations || score.heldout_misfit > kNoiseFloor);
  return score.detectable() || score.outcome != Outcome::Missed;
}

nlohmann::ordered_json to_json(const Score& score) {
  nlohmann::ordered_json json{{"kind", blind::to_string(score.request.kind)},
                              {"generator", blind::to_string(score.request.generator)},
                              {"seed", score.request.seed},
                              {"nats", score.nats},
                              {"outcome", to_string(score.outcome)},
                              {"verdict", to_string(score.verdict)},
                              {"named", score.named},
                              {"rivals", score.rivals},
                              {"location_right", score.location_right},
                              {"nats_apart", score.nats_apart},
                              {"explained_nats", score.explained_nats},
                              {"left_nats", score.left_nats},
                              {"heldout_misfit", score.heldout_misfit},
                              {"worst_parameter_sds", score.worst_parameter_sds},
                              {"cpu_s", score.cpu_s}};
  json["hidden"] = nlohmann::ordered_json::array();
  for (const HiddenEffect& effect : score.hidden)
    json["hidden"].push_back({{"name", effect.name}, {"form", effect.form}, {"values", effect.values}});
  if (!score.error.empty()) json["error"] = score.error;
  return json;
}

Request request_for(Kind kind, bool feedback, std::uint64_t seed, const Options& options) {
  Request request;
  request.kind = kind;
  request.feedback = feedback;
  request.seed = seed;
  request.reduced = options.reduced;
  request.effect = options.effect;
  const bool station = options.generator == "station" || (options.generator == "both" && seed % 2 == 0);
  const bool can_be_station = kind != Kind::OffList && !feedback;
  request.generator = station && can_be_station ? Generator::Station : Generator::Independent;
  if (request.effect.empty() && (kind == Kind::Single || kind == Kind::OffList)) {
    // Each as often as any other.
    const auto names = blind::effect_names(kind == Kind::Single, request.generator);
    const bool takes_turns = options.generator == "both" && kind == Kind::Single && can_be_station;
    const std::uint64_t turn = takes_turns ? seed / 2 : seed;
    request.effect = names[turn % names.size()];
  }
  return request;
}

std::vector<Request> requests_for(const Options& options) {
  std::vector<Request> requests;
  struct Part {
    Kind kind;
    bool feedback;
    int count;
  };
  const Part parts[] = {
      {Kind::Single, false, options.single},     {Kind::None, false, options.none},
      {Kind::OffList, false, options.offlist},   {Kind::Pair, false, options.pair},
      {Kind::None, true, options.none_feedback}, {Kind::Single, true, options.single_feedback}};
  for (const Part& part : parts)
    for (int i = 0; i < part.count; ++i)
      requests.push_back(
          request_for(part.kind, part.feedback, options.seed + static_cast<std::uint64_t>(i), options));
  return requests;
}

std::vector<Score> diagnose_all(const std::vector<Request>& requests, const Options& options) {
  std::vector<Score> scores(requests.size());
  std::atomic<std::size_t> next = 0;
  std::mutex terminal;
  std::size_t done = 0;
  const bool progress = isatty(STDERR_FILENO) != 0;
  const auto work = [&] {
    for (std::size_t i = next++; i < requests.size(); i = next++) {
      scores[i] = diagnose_one(requests[i], options);
      const std::scoped_lock lock(terminal);
      ++done;
      if (progress) fmt::print(stderr, "\r{} of {} sets", done, requests.size());
      if (options.list || (options.list_wrong && is_failure(scores[i]))) {
        fmt::print("{}{}\n", progress ? "\r" : "", describe(scores[i]));
        std::fflush(stdout);
      }
    }
  };
  std::vector<std::thread> workers;
  const unsigned count = options.jobs != 0 ? options.jobs : std::max(1u, std::thread::hardware_concurrency());
  for (unsigned i = 0; i < count; ++i) workers.emplace_back(work);
  for (std::thread& worker : workers) worker.join();
  if (progress) fmt::print(stderr, "\r");
  return scores;
}

void print_origin(int argc, char** argv, const Options& options) {
  fmt::print("\nFrom {}, seeds {} and up, clampd {}; intervals: Wilson's, 95 %\n",
             fmt::join(std::vector<std::string>(argv, argv + argc), " "), options.seed, kVersion);
}

void print_times(const std::vector<Score>& scores) {
  std::vector<double> times_s;
  for (const Score& score : scores) times_s.push_back(score.cpu_s);
  std::sort(times_s.begin(), times_s.end());
  if (times_s.empty()) return;
  const auto quantile = [&](double q) {
    return times_s[static_cast<std::size_t>(q * static_cast<double>(times_s.size() - 1))];
  };
  fmt::print("\nOne core, per set: median {:.1f} s, 95 % below {:.1f} s, longest {:.1f} s\n", quantile(0.5),
             quantile(0.95), times_s.back());
}

void print_details(const Score& score, const Diagnosis& diagnosis) {
  fmt::print("{}\n{}\n\n", describe(score), diagnosis.summary);
  for (const CandidateSummary& summary : diagnosis.candidates)
    fmt::print("  {} {:<22} predicted {:9.1f}  gain {:9.1f}  evidence {:8.1f}{}{}\n", summary.stage,
               summary.name, summary.predicted_gain, summary.gain, summary.significance_nats,
               summary.chosen ? "  chosen" : "", summary.rival ? "  rival" : "");
  for (const auto* tests : {&diagnosis.misfit.tests_before, &diagnosis.misfit.tests_after}) {
    fmt::print("\n{}\n", tests == &diagnosis.misfit.tests_before ? "Base model" : "Final model");
    for (const MisfitTest& test : *tests)
      fmt::print("  {:<44} {:10.4g}  p = {:.3g}\n", test.name, test.statistic, test.p_value);
  }
  fmt::print("\n");
  for (const NamedEffect& effect : diagnosis.effects)
    for (const EstimatedParameter& parameter : effect.parameters)
      fmt::print("  {} {} = {}\n", effect.name, parameter.name,
                 !parameter.choice.empty()
                     ? parameter.choice
                     : fmt::format("{:.5g} +- {:.2g} {}", parameter.value, parameter.sd, parameter.unit));
  for (const std::string& notice : diagnosis.notices) fmt::print("  {}\n", notice);
}

int run(int argc, char** argv) {
  CLI::App app{
      "Diagnoses sets of runs that hide what is wrong with the brake, and counts how often it is right"};
  Options options;
  app.add_option("--single", options.single, "sets with one effect of the list")->capture_default_str();
  app.add_option("--none", options.none, "sets without any")->capture_default_str();
  app.add_option("--offlist", options.offlist, "sets with one that is not on the list")
      ->capture_default_str();
  app.add_option("--pair", options.pair, "sets with two")->capture_default_str();
  app.add_option("--none-feedback", options.none_feedback,
                 "sets without any, whose controller computes a row's torque from that row's readings")
      ->capture_default_str();
  app.add_option("--single-feedback", options.single_feedback, "sets with one, the same")
      ->capture_default_str();
  app.add_option("--sets", options.sets, "so many sets in all, in the proportions above");
  app.add_option("--seed", options.seed, "of the first set of each kind")->capture_default_str();
  auto* only = app.add_option("--only", options.only, "the set with this seed of --kind, in detail");
  app.add_option("--kind", options.kind, "of --only")
      ->check(CLI::IsMember({"none", "single", "offlist", "pair"}));
  app.add_flag("--feedback", options.feedback, "of --only: with feedback in the row");
  app.add_option("--generator", options.generator, "whose brake")
      ->check(CLI::IsMember({"both", "station", "independent"}));
  app.add_option("--effect", options.effect, "always this one");
  app.add_flag("--reduced", options.reduced, "a random part of the runs only");
  app.add_flag("--list", options.list, "every set");
  app.add_flag("--list-wrong", options.list_wrong, "every failure, with the seed that repeats it");
  app.add_option("--json", options.json, "file for the score of each set");
  app.add_option("--keep", options.keep, "folder where the run files stay");
  app.add_option("--jobs", options.jobs, "sets at once; 0: one a core");
  CLI11_PARSE(app, argc, argv);

  if (only->count() > 0) {
    for (const Kind kind : {Kind::None, Kind::Single, Kind::OffList, Kind::Pair}) {
      if (blind::to_string(kind) != options.kind) continue;
      Diagnosis details;
      const Score score =
          diagnose_one(request_for(kind, options.feedback, options.only, options), options, &details);
      print_details(score, details);
    }
    return 0;
  }
  if (options.sets > 0) {
    const double scale =
        static_cast<double>(options.sets) / (options.single + options.none + options.offlist + options.pair +
                                             options.none_feedback + options.single_feedback);
    for (int* count : {&options.single, &options.none, &options.offlist, &options.pair,
                       &options.none_feedback, &options.single_feedback})
      *count = static_cast<int>(std::lround(*count * scale));
  }
  const std::vector<Score> scores = diagnose_all(requests_for(options), options);
  const auto of = [](Generator generator) {
    return [=](const Score& s) { return !s.request.feedback && s.request.generator == generator; };
  };
  print_singles(scores, "both generators", [](const Score& s) { return !s.request.feedback; });
  if (options.generator == "both") {
    print_singles(scores, "the station's brake", of(Generator::Station));
    print_singles(scores, "the independent brake", of(Generator::Independent));
  }
  print_singles(scores, "feedback in the row", [](const Score& s) { return s.request.feedback; });
  print_others(scores);
  print_confusion(scores);
  print_times(scores);
  print_origin(argc, argv, options);
  if (!options.json.empty()) {
    nlohmann::ordered_json json = nlohmann::ordered_json::array();
    for (const Score& score : scores) json.push_back(to_json(score));
    if (const Result<void> written = write_file_atomically(options.json, json.dump(1) + "\n"); !written) {
      fmt::print(stderr, "{}\n", written.error().message);
      return 2;
    }
  }
  return 0;
}

}  // namespace
}  // namespace clampd::bench

int main(int argc, char** argv) {
  return clampd::bench::run(argc, argv);
}
