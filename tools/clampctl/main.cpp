#include <CLI/CLI.hpp>

#include "clampd/base/version.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/terminal.hpp"

int main(int argc, char** argv) {
  using namespace clampd;
  CLI::App app{"clampctl checks electromechanical brakes and works with what clampd recorded."};
  app.set_version_flag("--version", std::string(kVersion));
  app.fallthrough();
  app.footer(
      "Exit codes: 0 pass or success, 1 the brake fails, 2 wrong usage or bad input,\n"
      "3 the station made the result invalid, 4 aborted, 5 timed out.");
  ctl::CommonOptions common;
  app.add_option("--config", common.config,
                 "station configuration (default: /etc/clampd/station.toml if it is there)")
      ->type_name("FILE");

  int exit_code = cli::kSuccess;
  ctl::add_run_command(app, common, exit_code);
  ctl::add_identify_command(app, exit_code);
  ctl::add_diagnose_command(app, exit_code);
  ctl::add_predict_command(app, exit_code);
  ctl::add_drive_command(app, exit_code);
  ctl::add_effects_command(app, exit_code);
  ctl::add_design_command(app, exit_code);
  ctl::add_simulate_command(app, exit_code);
  ctl::add_reproduce_command(app, exit_code);
  ctl::add_station_commands(app, common, exit_code);
  ctl::add_watch_commands(app, common, exit_code);
  ctl::add_results_command(app, common, exit_code);
  ctl::add_records_commands(app, common, exit_code);
  ctl::add_archive_commands(app, common, exit_code);
  ctl::add_report_command(app, common, exit_code);
  ctl::add_statistics_commands(app, common, exit_code);
  ctl::add_line_command(app, exit_code);
  ctl::add_gauge_command(app, common, exit_code);
  ctl::add_master_command(app, common, exit_code);
  ctl::add_doctor_command(app, common, exit_code);
  ctl::add_can_command(app, common, exit_code);

  try {
    app.parse(argc, argv);
    if (app.get_subcommands().empty()) {
      cli::print_error("name a command, for example `clampctl run --serial S`; `clampctl --help` lists them");
      return cli::kBadInput;
    }
  } catch (const CLI::Success& request) {  // --help, --version
    return app.exit(request);
  } catch (const CLI::ParseError& mistake) {
    app.exit(mistake);
    return cli::kBadInput;
  } catch (const std::exception& unexpected) {
    cli::print_error(std::string("unexpected: ") + unexpected.what() + ". Please report this.");
    return cli::kStation;
  }
  return exit_code;
}
