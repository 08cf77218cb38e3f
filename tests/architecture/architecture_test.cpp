#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "architecture/rules.hpp"

namespace clampd::architecture {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
namespace fs = std::filesystem;

const fs::path kTree = CLAMPD_SOURCE_DIR;

std::string content_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

bool is_source(const fs::path& path) {
  static const std::set<std::string> kExtensions{".cpp", ".hpp", ".c", ".cc", ".h", ".inl", ".ipp"};
  return kExtensions.count(path.extension().string()) > 0;
}

struct SourceFile {
  std::string path;  ///< in the tree
  std::string content;
};

std::vector<SourceFile> product_sources() {
  std::vector<SourceFile> files;
  for (const char* folder : {"include", "src", "rt", "drivers", "tools"})
    for (const auto& entry : fs::recursive_directory_iterator(kTree / folder))
      if (entry.is_regular_file() && is_source(entry.path()))
        files.push_back({fs::relative(entry.path(), kTree).generic_string(), content_of(entry.path())});
  return files;
}

TEST(Architecture, TheTreeKeepsItsRules) {
  const std::vector<SourceFile> files = product_sources();
  EXPECT_GT(files.size(), 20U) << "the walk must have seen the tree";
  for (const SourceFile& file : files)
    for (const std::string& violation : violations(file.path, file.content)) ADD_FAILURE() << violation;
}

TEST(Architecture, OnlyItsOwnFileNamesAnEffect) {
  const std::vector<SourceFile> files = product_sources();
  std::vector<std::string> effects;
  for (const SourceFile& file : files) {
    if (file.path.rfind("src/brake/effects/", 0) != 0) continue;
    const std::vector<std::string> names = effects_named_in(file.content);
    EXPECT_LE(names.size(), 1U) << file.path << " is one effect's";
    effects.insert(effects.end(), names.begin(), names.end());
  }
  EXPECT_GE(effects.size(), 24U) << "the effects' files must have been read";
  for (const SourceFile& file : files) {
    // Bare drives have effects of their own, some of the same name.
    if (file.path.find("/diagnose/drive_") != std::string::npos || file.path.find("/drive/") != std::string::npos) continue;
    for (const std::string& violation : effects_named_elsewhere(file.path, file.content, effects)) ADD_FAILURE() << violation;
  }
}

TEST(Rules, CatchAnEffectThatIsNamedElsewhere) {
  EXPECT_THAT(effects_named_in("{.name = \"belt-slip\",\n  .location = Location::Timing, .parameters = {{.name = \"share\",\n.unit = 1}}}"),
              ElementsAre("belt-slip"));
  const std::vector<std::string> effects{"belt-slip"};
  EXPECT_THAT(effects_named_elsewhere("src/diagnose/a.cpp", "int x;\nif (name == \"belt-slip\") f();", effects),
              ElementsAre(HasSubstr("a.cpp:2: names the effect belt-slip")));
  EXPECT_THAT(effects_named_elsewhere("src/views/a.cpp", "f(\"because of belt-slip.\");", effects), ElementsAre(HasSubstr("belt-slip")));
  EXPECT_THAT(effects_named_elsewhere("src/views/a.cpp", "f(\"belt-slippage\");  // belt-slip", effects), IsEmpty());
  EXPECT_THAT(effects_named_elsewhere("drivers/sim/effects.hpp", "f(\"belt-slip\");", effects), IsEmpty());
}

TEST(Architecture, ArrowsPointDown) {
  std::set<std::string_view> above;
  for (const auto& [room, targets] : arrows()) {
    for (const std::string_view target : targets)
      EXPECT_EQ(above.count(target), 1U) << room << " may include " << target << ", which is not above it";
    EXPECT_TRUE(above.insert(room).second) << room << " is listed twice";
  }
}

struct Planted {
  std::string label;
  std::string path;
  std::string text;
  std::string caught;  ///< empty: allowed
};
void PrintTo(const Planted& planted, std::ostream* out) {
  *out << planted.label;
}

class PlantedRules : public ::testing::TestWithParam<Planted> {};

TEST_P(PlantedRules, CatchWhatIsPlantedAndNothingElse) {
  const Planted& planted = GetParam();
  const auto found = violations(planted.path, planted.text);
  if (planted.caught.empty())
    EXPECT_THAT(found, IsEmpty());
  else
    EXPECT_THAT(found, ElementsAre(HasSubstr(planted.caught)));
}

INSTANTIATE_TEST_SUITE_P(
    Planted, PlantedRules,
    ::testing::Values(
        Planted{"upward", "src/record/a.cpp", "#include \"clampd/parameters/brake_parameters.hpp\"\n",
                "a.cpp:1: record must not"},
        Planted{"upward_header", "include/clampd/identify/a.hpp",
                "\n\n #  include <clampd/station/limits.hpp>", "a.hpp:3:"},
        Planted{"rt_to_driver", "rt/a.cpp", "#include \"drivers/can/dbc.hpp\"",
                "rt must not include drivers/can/dbc.hpp"},
        Planted{"driver_to_rt", "drivers/can/a.hpp", "#include \"rt/ring.hpp\"", "drivers/can must not"},
        Planted{"driver_to_driver", "drivers/can/a.hpp", "#include \"drivers/sim/plant.hpp\"",
                "drivers/can must not"},
        Planted{"sim_to_parameters", "drivers/sim/a.hpp", "#include \"clampd/parameters/brake_parameters.hpp\"", ""},
        Planted{"sim_to_integrator", "drivers/sim/a.cpp", "#include \"clampd/brake/integrator.hpp\"",
                "drivers/sim must not"},
        Planted{"can_to_parameters", "drivers/can/a.cpp", "#include \"clampd/parameters/brake_parameters.hpp\"",
                "drivers/can must not"},
        Planted{"station_to_rt", "src/station/a.cpp", "#include \"rt/supervisor.hpp\"", "station must not"},
        Planted{"rt_to_law", "rt/a.cpp", "#include \"clampd/control/control_law.hpp\"", ""},
        Planted{"design_to_law", "src/experiment/a.cpp", "#include \"clampd/control/control_law.hpp\"", ""},
        Planted{"law_to_brake", "src/control/a.cpp", "#include \"clampd/brake/stiffness.hpp\"",
                "control must not"},
        Planted{"law_to_rt", "include/clampd/control/a.hpp", "#include \"rt/check_sequence.hpp\"",
                "control must not"},
        Planted{"law_to_design", "src/control/a.cpp", "#include \"clampd/experiment/reference.hpp\"",
                "control must not"},
        Planted{"design_to_rt", "src/experiment/a.cpp", "#include \"rt/check_sequence.hpp\"",
                "experiment must not"},
        Planted{"sim_to_law", "drivers/sim/a.cpp", "#include \"clampd/control/nominal_drive.hpp\"",
                "drivers/sim must not"},
        Planted{"archive_to_identify", "src/archive/a.cpp", "#include \"clampd/identify/output_error.hpp\"",
                "archive must not"},
        Planted{"line_to_views", "src/line/a.cpp", "#include \"clampd/views/page.hpp\"", "line must not"},
        Planted{"diagnose_to_views", "src/diagnose/a.cpp", "#include \"clampd/views/diagnosis_words.hpp\"", "diagnose must not"},
        Planted{"experiment_to_diagnose", "src/experiment/a.cpp", "#include \"clampd/diagnose/diagnosis.hpp\"",
                "experiment must not"},
        Planted{"views_to_bench", "src/views/a.cpp", "#include \"clampd/bench/prepared_station.hpp\"", "views must not"},
        Planted{"bench_to_api", "src/bench/a.cpp", "#include \"clampd/api/messages.hpp\"", "bench must not"},
        Planted{"api_to_daemon", "src/api/a.cpp", "#include \"clampd/daemon/daemon.hpp\"", "api must not"},
        Planted{"http_to_api", "src/http/a.cpp", "#include \"clampd/api/messages.hpp\"", "http must not"},
        Planted{"record_to_ports", "src/record/a.cpp", "#include \"clampd/ports/brake_port.hpp\"", "record must not"},
        Planted{"rt_to_simulation", "rt/a.cpp", "#include \"clampd/simulation/simulate.hpp\"", "rt must not"},
        Planted{"tool_to_tool", "tools/reproduce/a.cpp", "#include \"tools/cli/terminal.hpp\"", "tools/reproduce must not"},
        Planted{"tool_to_room", "tools/cli/a.cpp", "#include \"clampd/station/session.hpp\"", "tools/cli must not"},
        Planted{"unknown_tool", "tools/novel/a.cpp", "#include \"clampd/base/result.hpp\"", "tools/novel has no arrows"},
        Planted{"tool_down", "tools/clampctl/a.cpp", "#include \"clampd/bench/prepared_station.hpp\"\n#include \"rt/readiness.hpp\"", ""},
        Planted{"src_to_tools", "src/station/a.cpp", "#include \"tools/cli/terminal.hpp\"",
                "station must not"},
        Planted{"src_to_tests", "src/station/a.cpp", "#include \"tests/support/x.hpp\"", "station must not"},
        Planted{"downward", "src/station/a.cpp",
                "#include \"clampd/identify/output_error.hpp\"\n#include <vector>", ""},
        Planted{"tests_are_free", "tests/rt/a.cpp", "#include \"drivers/sim/x.hpp\"\nvoid f() { throw 1; }",
                ""},
        Planted{"unknown_room", "src/novel/a.cpp", "#include \"clampd/base/result.hpp\"",
                "novel has no arrows"},
        Planted{"dots", "src/brake/a.cpp", "#include \"../base/x.hpp\"", "leaves its folder"},
        Planted{"commented_out", "src/record/a.cpp",
                "// #include \"rt/ring.hpp\"\n/*\n#include \"rt/a.hpp\"\n*/", ""},
        Planted{"ceres_in_identify", "src/identify/a.cpp", "#include <ceres/ceres.h>", ""},
        Planted{"ceres_in_its_header", "include/clampd/identify/a.hpp", "#include <ceres/ceres.h>",
                "must not include <ceres"},
        Planted{"ceres_elsewhere", "src/brake/a.cpp", "#include <ceres/ceres.h>", "must not include <ceres"},
        Planted{"jets_in_brake", "src/brake/a.cpp", "#include <ceres/jet.h>", ""},
        Planted{"jets_elsewhere", "src/experiment/a.cpp", "#include <ceres/jet.h>",
                "must not include <ceres"},
        Planted{"nlopt_elsewhere", "src/identify/a.cpp", "#include <nlopt.hpp>", "must not include <nlopt"},
        Planted{"ipopt_elsewhere", "tools/x/a.cpp", "#include <IpIpoptApplication.hpp>",
                "must not include <Ip"},
        Planted{"sqlite_elsewhere", "tools/x/a.cpp", "#include <SQLiteCpp/Database.h>",
                "must not include <SQLite"},
        Planted{"command_line_in_a_room", "src/bench/a.cpp", "#include <CLI/CLI.hpp>", "must not include <CLI"},
        Planted{"mqtt_elsewhere", "tools/clampd/a.cpp", "#include <mosquitto.h>",
                "must not include <mosquitto"},
        Planted{"postgresql_in_its_header", "include/clampd/publish/a.hpp", "#include <pqxx/pqxx>",
                "must not include <pqxx"},
        Planted{"publish_to_station", "src/publish/a.cpp", "#include \"clampd/station/configuration.hpp\"",
                "publish must not"},
        Planted{"function_in_rt", "rt/a.hpp", "std::function<void()> f;", "std::function"},
        Planted{"throw_in_rt", "rt/a.cpp", "void f() {\n  throw 1;\n}",
                "a.cpp:2: the real-time path must not use throw"},
        Planted{"new_in_rt", "rt/a.cpp", "int* f() { return new int; }", "must not use new"},
        Planted{"lock_in_rt", "rt/a.cpp", "std::mutex m;", "a mutex"},
        Planted{"log_in_rt", "rt/a.cpp", "void f() { spdlog::info(\"\"); }", "logging"},
        Planted{"iostream_in_rt", "rt/a.cpp", "#include <iostream>", "that header"},
        Planted{"string_in_rt", "rt/a.cpp", "std::string s;", "a string"},
        Planted{"new_in_law", "src/control/a.cpp", "int* f() { return new int; }", "must not use new"},
        Planted{"words_in_rt_comments", "rt/a.cpp",
                "// a new throw\nconst char* s = \"new mutex; throw\";\nint new_x; std::string_view v; int y "
                "= 1'000; char c = '\"';",
                ""},
        Planted{"setup_in_rt", "rt/cyclic_thread.cpp", "std::mutex m; void f() { throw 1; }", ""},
        Planted{"mark_without_noexcept", "drivers/can/a.hpp",
                "CLAMPD_REALTIME\nint f(int x);\nint g() noexcept;", "not noexcept"},
        Planted{"mark_with_noexcept", "rt/a.hpp",
                "  CLAMPD_REALTIME virtual bool f(\n  int x) const\n  noexcept = 0;", ""}),
    [](const auto& planted) { return planted.param.label; });

}  // namespace
}  // namespace clampd::architecture
