#include <memory>

#include <fmt/format.h>

#include "clampd/views/effect_list.hpp"
#include "tools/clampctl/command.hpp"

namespace clampd::ctl {

void add_effects_command(CLI::App& app, int& exit_code) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command =
      app.add_subcommand("effects", "what a diagnosis knows: the effects of brakes and of bare drives");
  command->add_flag("--json", *json, "as JSON on standard output");
  command->callback([json, &exit_code] {
    fmt::print("{}", *json ? effects_json().dump(2) + "\n" : format_effects());
    exit_code = cli::kSuccess;
  });
}

}  // namespace clampd::ctl
