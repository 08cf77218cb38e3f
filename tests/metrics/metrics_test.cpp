// What Prometheus makes of a real daemon: its own tools, its own server, the shipped rules and dashboard.

#include <csignal>
#include <fstream>
#include <iterator>
#include <optional>
#include <regex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/http/client.hpp"
#include "faults/station.hpp"
#include "support/command.hpp"
#include "support/eventually.hpp"
#include "support/network.hpp"

namespace clampd {
namespace {

using support::eventually;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;

const std::string kShipped = CLAMPD_SOURCE_DIR "/configs/prometheus/";

std::string text_of(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

http::Answer get(int port, const std::string& path, const std::string& method = "GET") {
  http::Call call;
  call.method = method;
  call.path = path;
  const auto answer = http::exchange("127.0.0.1", port, call);
  EXPECT_TRUE(answer) << path << ": " << answer.error().message;
  return answer.value_or(http::Answer{});
}

/// Names of metrics that stand in a text; those of a histogram by its own name.
std::set<std::string> metrics_in(const std::string& text) {
  static const std::regex name("clampd_[a-z_]+"), part("_(bucket|sum|count)$");
  std::set<std::string> names;
  for (std::sregex_iterator at(text.begin(), text.end(), name), end; at != end; ++at)
    names.insert(std::regex_replace(at->str(), part, ""));
  return names;
}

TEST(Metrics, RulesAndDashboardAskForWhatTheDaemonSays) {
  faults::Station station;
  station.start();
  const http::Answer scrape = get(station.port(), "/metrics");
  EXPECT_EQ(scrape.status, 200);
  std::set<std::string> said;
  static const std::regex type("# TYPE (clampd_[a-z_]+) ");
  for (std::sregex_iterator at(scrape.body.begin(), scrape.body.end(), type), end; at != end; ++at)
    said.insert((*at)[1]);
  EXPECT_GE(said.size(), 15u);
  // A worker says the same whether its database answers or not.
  support::TemporaryDirectory folder;
  const int worker_port = support::free_port();
  const std::string config =
      folder.write("worker.toml", "[postgresql]\nhost = \"127.0.0.1\"\nport = 1\ndatabase = \"line\"\n");
  const screen::Program worker(
      {CLAMPD_WORKER, "--config", config, "--metrics", fmt::format("127.0.0.1:{}", worker_port)},
      folder.path("log"));
  http::Call call;
  call.path = "/metrics";
  Result<http::Answer> of_worker;
  ASSERT_TRUE(eventually([&] {
    return (of_worker = http::exchange("127.0.0.1", worker_port, call)).has_value();
  })) << folder.read("log");
  for (std::sregex_iterator at(of_worker->body.begin(), of_worker->body.end(), type), end; at != end; ++at)
    said.insert((*at)[1]);

  const std::string rules = text_of(kShipped + "clampd.rules.yml");
  const std::string dashboard = text_of(kShipped + "dashboard.json");
  EXPECT_THAT(said, IsSupersetOf(metrics_in(rules)));
  EXPECT_THAT(said, IsSupersetOf(metrics_in(dashboard)));
  EXPECT_THAT(metrics_in(text_of(CLAMPD_SOURCE_DIR "/docs/metrics.md")), IsSupersetOf(said));
  // The bound that the rule about lateness asks for is one of the histogram's.
  EXPECT_THAT(scrape.body, HasSubstr("clampd_loop_lateness_seconds_bucket{le=\"0.0005\"}"));
  for (const auto& panel : nlohmann::json::parse(dashboard).at("panels"))
    EXPECT_FALSE(panel.at("targets").empty());

  for (const std::string& text : {scrape.body, of_worker->body}) {
    const support::Outcome lint =
        support::run_command("promtool check metrics <" + folder.write("scrape", text));
    EXPECT_EQ(lint.exit_code, 0) << lint.output;
  }
}

TEST(Metrics, AlertsComeWhenTheyShould) {
  const support::Outcome checked =
      support::run_command("promtool check rules " + kShipped + "clampd.rules.yml");
  EXPECT_EQ(checked.exit_code, 0) << checked.output;
  support::TemporaryDirectory folder;
  std::string tests = text_of(CLAMPD_SOURCE_DIR "/tests/metrics/clampd.rules.test.yml");
  tests.replace(tests.find("RULES"), 5, kShipped + "clampd.rules.yml");
  const support::Outcome tested =
      support::run_command("promtool test rules " + folder.write("test.yml", tests));
  EXPECT_EQ(tested.exit_code, 0) << tested.output;
}

/// A Prometheus with the shipped configuration, which asks every second and keeps its data in the folder.
class Prometheus {
 public:
  Prometheus(const support::TemporaryDirectory& folder, int station) : port_(support::free_port()) {
    std::string text = text_of(kShipped + "prometheus.yml");
    text = std::regex_replace(text, std::regex("15s"), "1s\n  evaluation_interval: 1s");
    text = std::regex_replace(text, std::regex("clampd.rules.yml"), kShipped + "clampd.rules.yml");
    text = std::regex_replace(text, std::regex("8371"), std::to_string(station));
    const std::string file = folder.write("prometheus.yml", text);
    program_.emplace(std::vector<std::string>{"/usr/bin/prometheus", "--config.file=" + file,
                                              "--storage.tsdb.path=" + folder.path("data"),
                                              fmt::format("--web.listen-address=127.0.0.1:{}", port_)},
                     folder.path("prometheus.log"));
    EXPECT_TRUE(eventually([&] { return http::exchange("127.0.0.1", port_, ready()).has_value(); }))
        << folder.read("prometheus.log");
  }

  /// The one value that a query gives; nothing if there is none or there are several.
  std::optional<double> value(const std::string& query) const {
    http::Call call = ready();
    call.path = "/api/v1/query?query=";
    for (const char c : query) call.path += fmt::format("%{:02X}", static_cast<unsigned>(c));
    const auto answer = http::exchange("127.0.0.1", port_, call);
    const auto document = nlohmann::json::parse(answer ? answer->body : "", nullptr, false);
    if (document.is_discarded() || document.value("status", "") != "success") return std::nullopt;
    const auto& result = document.at("data").at("result");
    if (result.size() != 1) return std::nullopt;
    return std::stod(result[0].at("value")[1].get<std::string>());
  }

 private:
  static http::Call ready() {
    http::Call call;
    call.path = "/-/ready";
    return call;
  }
  int port_;
  std::optional<screen::Program> program_;
};

TEST(Metrics, ARealPrometheusFollowsAStation) {
  faults::Station station;
  station.start();
  ASSERT_TRUE(station.wait_for_idle());
  support::TemporaryDirectory folder;
  const Prometheus prometheus(folder, station.port());
  const auto becomes = [&](const std::string& query, double wanted) {
    return eventually([&] { return prometheus.value(query) == wanted; });
  };
  EXPECT_TRUE(becomes("up{job=\"clampd\"}", 1.0)) << folder.read("prometheus.log");
  EXPECT_TRUE(becomes(
      "clampd_state == 1 and on(state) label_replace(vector(1), \"state\", \"IDLE\", \"\", \"\")", 1.0));
  EXPECT_TRUE(becomes("sum(clampd_checks_total)", 0.0));

  ASSERT_TRUE(station.client().start({.serial = "P-1"}));
  EXPECT_EQ(station.finished().at("verdict"), "PASS");
  EXPECT_TRUE(becomes("clampd_checks_total{verdict=\"PASS\"}", 1.0));
  EXPECT_TRUE(becomes("sum(clampd_checks_total)", 1.0));
  EXPECT_TRUE(becomes("clampd_outbox_pending{channel=\"mqtt\"}", 1.0)) << "nothing takes it";
  EXPECT_TRUE(becomes("clampd_outbox_connected{channel=\"mqtt\"}", 0.0));
  // Each period of the loop is in the histogram.
  EXPECT_TRUE(becomes("clampd_loop_lateness_seconds_count > bool 1000", 1.0));
  EXPECT_TRUE(
      becomes("clampd_loop_lateness_seconds_bucket{le=\"+Inf\"} == bool ignoring(le) "
              "clampd_loop_lateness_seconds_count",
              1.0));

  station.end(SIGKILL);
  EXPECT_TRUE(becomes("up{job=\"clampd\"}", 0.0));
  EXPECT_TRUE(becomes("ALERTS{alertname=\"ClampdStationAway\",alertstate=\"pending\"}", 1.0));
}

TEST(Metrics, AHundredAtOnceAreAnsweredOrToldToComeBack) {
  faults::Station station;
  station.start();
  std::vector<int> statuses(100);
  {
    std::vector<std::jthread> scrapers;
    for (int& status : statuses)
      scrapers.emplace_back([&] { status = get(station.port(), "/metrics").status; });
  }
  for (const int status : statuses) EXPECT_TRUE(status == 200 || status == 503) << status;
  EXPECT_THAT(statuses, ::testing::Contains(200));
  EXPECT_EQ(get(station.port(), "/metrics", "HEAD").status, 200);
  EXPECT_EQ(get(station.port(), "/metrics").status, 200);
}

}  // namespace
}  // namespace clampd
