// Blind sets as run files, the answers sealed in a folder of their own.

#include <exception>
#include <filesystem>
#include <string>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "clampd/record/file.hpp"
#include "tests/support/blind/detectability.hpp"

namespace clampd::blind {
namespace {

struct Options {
  std::string folder;
  int count = 1;
  std::uint64_t seed = 1;
  Request request;
  bool lambda = false;
};

Result<void> write_set(const Options& options, int number) {
  Request request = options.request;
  request.seed = options.seed + static_cast<std::uint64_t>(number) - 1;
  const Result<BlindSet> set = make_set(request);
  if (!set) return tl::unexpected(set.error());
  if (options.lambda) {
    const Answer& answer = set->answer;
    fmt::print("{:6} {:8.1f} nats", request.seed, detectability_nats(*set));
    for (const HiddenEffect& effect : answer.effects) {
      fmt::print("  {} ({})", effect.name, effect.form);
      for (const auto& [name, value] : effect.values) fmt::print(" {}={:.3g}", name, value);
    }
    fmt::print("\n");
  }
  if (options.folder.empty()) return {};
  const std::filesystem::path folder = options.folder;
  const auto written = write_runs(set->runs, (folder / fmt::format("{:04}", number)).string());
  if (!written) return tl::unexpected(written.error());
  return write_file_atomically((folder / "answers" / fmt::format("{:04}.json", number)).string(),
                               answer_json(set->answer) + "\n");
}

int run(int argc, char** argv) {
  CLI::App app{"Run files of brakes that hide an effect, or none, or two, or one that is on no list"};
  Options options;
  std::string kind = "single", generator = "independent";
  app.add_option("--out", options.folder, "folder for NNNN/run-*.csv and answers/NNNN.json");
  app.add_option("--count", options.count, "sets; each seed is one more than the one before");
  app.add_option("--seed", options.seed, "of the first set");
  app.add_option("--kind", kind)->check(CLI::IsMember({"none", "single", "offlist", "pair"}));
  app.add_option("--generator", generator)->check(CLI::IsMember({"station", "independent"}));
  app.add_option("--effect", options.request.effect, "the effect to hide, instead of a drawn one");
  app.add_flag("--feedback", options.request.feedback,
               "a row's torque is computed from that row's readings (independent generator)");
  app.add_flag("--reduced", options.request.reduced, "a random part of the runs only");
  app.add_flag("--lambda", options.lambda, "print what is hidden and how detectable it is");
  CLI11_PARSE(app, argc, argv);
  for (const Kind each : {Kind::None, Kind::Single, Kind::OffList, Kind::Pair})
    if (to_string(each) == kind) options.request.kind = each;
  if (generator == "station") options.request.generator = Generator::Station;
  if (options.request.kind == Kind::OffList && options.request.generator == Generator::Station) {
    fmt::print(stderr,
               "blind_sets: the station's brake has no effects off the list; use --generator independent\n");
    return 2;
  }
  if (options.request.feedback && options.request.generator == Generator::Station) {
    fmt::print(stderr, "blind_sets: the station has its own controller; use --generator independent\n");
    return 2;
  }
  if (!options.folder.empty()) {
    std::error_code failed;
    std::filesystem::create_directories(std::filesystem::path(options.folder) / "answers", failed);
  }
  for (int number = 1; number <= options.count; ++number)
    if (const Result<void> done = write_set(options, number); !done) {
      fmt::print(stderr, "blind_sets: set {}: {}\n", number, done.error().message);
      return 2;
    }
  return 0;
}

}  // namespace
}  // namespace clampd::blind

int main(int argc, char** argv) {
  return clampd::blind::run(argc, argv);
}
