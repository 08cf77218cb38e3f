#include <cmath>
#include <memory>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/record/file.hpp"
#include "clampd/views/figure.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"
#include "tools/reproduce/claims.hpp"
#include "tools/reproduce/json.hpp"
#include "tools/reproduce/report.hpp"

namespace clampd::ctl {

namespace {

struct ReproduceOptions {
  reproduce::StudyOptions study;
  std::string out = "clampd-reproduction.html";
  std::string json;
};

Result<void> prepare(const ReproduceOptions& options) {
  if (Result<void> valid = options.study.validate(); !valid) return valid;
  for (const std::string* path : {&options.out, &options.json})
    if (Result<void> writable = cli::check_writable(*path); !writable) return writable;
  if (options.out.empty() || options.out == "-") return failure("--out needs the name of a file");
  if (options.out == options.json) return failure("--json and --out name the same file");
  return report::can_draw();
}

int run_reproduction(ReproduceOptions options) {
  if (const Result<void> prepared = prepare(options); !prepared) return cli::refuse(prepared.error());
  cli::ProgressLine progress;
  options.study.progress = [&progress](double fraction, std::string_view stage) {
    progress.show(fraction, stage);
  };
  const Result<reproduce::Study> study = reproduce::compute_study(options.study);
  if (!study) return cli::refuse(study.error());
  progress.show(1.0, "figures");
  const Result<std::string> html = reproduce::report_html(*study);
  progress.clear();
  if (!html) return cli::refuse(html.error());
  if (const Result<void> written = write_file_atomically(options.out, *html); !written)
    return cli::refuse(written.error());
  if (const Result<void> written = cli::write_json(options.json, reproduce::study_json(*study)); !written)
    return cli::refuse(written.error());
  if (options.json == "-") return cli::kSuccess;
  for (const reproduce::Claim& claim : reproduce::claims_of(*study, reproduce::findings_of(*study)))
    fmt::print("{:<18}  {:<17}  {}\n", claim.verdict, claim.where, claim.paper);
  fmt::print("\n{} ({:.0f} s)\n", options.out, study->wall_s);
  return cli::kSuccess;
}

}  // namespace

void add_reproduce_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<ReproduceOptions>();
  CLI::App* command = app.add_subcommand(
      "reproduce", "the paper's figures and Table II on the simulated brake, as one HTML report");
  command->add_option("--out", options->out, "the report")->type_name("FILE.html")->capture_default_str();
  command->add_option("--json", options->json, "also write the key figures as clampd.reproduction/1")
      ->type_name("FILE");
  command
      ->add_option("--seed", options->study.seed,
                   "of designs and noise; the same seed gives the same figures")
      ->capture_default_str();
  command->add_option("--repeats", options->study.repeats, "of each experiment")->capture_default_str();
  command->add_option("--starts", options->study.starts, "local searches a design; more find better designs")
      ->capture_default_str();
  command->callback([options, &exit_code] { exit_code = run_reproduction(*options); });
}

}  // namespace clampd::ctl
