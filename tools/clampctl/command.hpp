#pragma once

#include <string>

#include <CLI/App.hpp>

#include "clampd/station/session.hpp"
#include "tools/cli/exit_code.hpp"

namespace clampd::ctl {

/// Options that every command understands.
struct CommonOptions {
  std::string config;  ///< station configuration; empty: the installed one if there is one
};

/// What a check is asked for with: serial, operator, part number, batch.
void add_request_options(CLI::App& command, CheckRequest& request);

/// Each command declares its own options on `app` and leaves its exit code in `exit_code` when it runs.
void add_run_command(CLI::App& app, const CommonOptions& common, int& exit_code);
void add_identify_command(CLI::App& app, int& exit_code);
void add_diagnose_command(CLI::App& app, int& exit_code);
void add_predict_command(CLI::App& app, int& exit_code);
void add_drive_command(CLI::App& app, int& exit_code);  ///< drive new
void add_effects_command(CLI::App& app, int& exit_code);
void add_design_command(CLI::App& app, int& exit_code);
void add_simulate_command(CLI::App& app, int& exit_code);
void add_reproduce_command(CLI::App& app, int& exit_code);
void add_station_commands(CLI::App& app, const CommonOptions& common,
                          int& exit_code);  ///< status, next, stop, clear
void add_watch_commands(CLI::App& app, const CommonOptions& common,
                        int& exit_code);  ///< watch, screen
void add_results_command(CLI::App& app, const CommonOptions& common, int& exit_code);
void add_records_commands(CLI::App& app, const CommonOptions& common,
                          int& exit_code);  ///< records verify, backup, restore
void add_archive_commands(CLI::App& app, const CommonOptions& common,
                          int& exit_code);  ///< archive submit, status, results, compare, retry, cancel
void add_report_command(CLI::App& app, const CommonOptions& common, int& exit_code);
void add_statistics_commands(CLI::App& app, const CommonOptions& common,
                             int& exit_code);  ///< statistics, limits
void add_line_command(CLI::App& app, int& exit_code);
void add_gauge_command(CLI::App& app, const CommonOptions& common, int& exit_code);
void add_master_command(CLI::App& app, const CommonOptions& common, int& exit_code);
void add_doctor_command(CLI::App& app, const CommonOptions& common, int& exit_code);
void add_can_command(CLI::App& app, const CommonOptions& common, int& exit_code);  ///< can check

}  // namespace clampd::ctl
