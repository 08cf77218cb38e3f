// What the archive costs beside identification: processor time, rows of the queue, disk. docs/line.md has the
// figures; they are those of the machine and of what else it does.

#include <sys/resource.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

#include <fmt/format.h>

#include "clampd/reanalysis/analysis.hpp"
#include "factory/published_factory.hpp"
#include "src/reanalysis/queue.hpp"
#include "support/shipped_limits.hpp"

namespace clampd::factory {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

/// Throws what went wrong.
template <class Value>
Value value_of(Result<Value> result) {
  if (!result) throw std::runtime_error(result.error().message);
  return std::move(*result);
}

double since_s(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

double cpu_of_children_s() {
  rusage usage{};
  ::getrusage(RUSAGE_CHILDREN, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

double cpu_of_this_thread_s() {
  timespec time{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// Fields of /proc/PID/stat behind the name, the first of which is the state; empty: no such process.
std::vector<std::string> status_of(const std::string& process) {
  std::ifstream file("/proc/" + process + "/stat");
  std::string text{std::istreambuf_iterator<char>(file), {}};
  std::vector<std::string> fields;
  if (text.rfind(')') == std::string::npos) return fields;
  std::istringstream words(text.substr(text.rfind(')') + 1));
  for (std::string word; words >> word;) fields.push_back(word);
  return fields;
}

/// Of a server with all its processes, those that ended too.
double cpu_of_server_s(const support::Database& server) {
  const std::string postmaster = server.ask("SELECT split_part(pg_read_file('postmaster.pid'), E'\\n', 1)");
  const auto ticks = [](const std::vector<std::string>& fields, std::size_t first, std::size_t last) {
    double sum = 0.0;
    for (std::size_t i = first; i <= last; ++i) sum += std::stod(fields.at(i));
    return sum;
  };
  double sum = ticks(status_of(postmaster), 11, 14);  // its own and that of children that ended
  for (const auto& entry : fs::directory_iterator("/proc")) {
    const std::string name = entry.path().filename();
    if (name.find_first_not_of("0123456789") != std::string::npos) continue;
    const std::vector<std::string> fields = status_of(name);
    if (fields.size() > 12 && fields[1] == postmaster) sum += ticks(fields, 11, 12);
  }
  return sum / static_cast<double>(::sysconf(_SC_CLK_TCK));
}

/// Processor time of a worker beside identification, in s a check.
struct WorkersShare {
  double reading_s = 0.0;   ///< the check and its runs, unpacked
  double claiming_s = 0.0;  ///< and writing the result
};

double reading_s(const PublishedFactory& factory) {
  reanalysis::Task task;
  task.limits = support::shipped_limits();
  publish::WakeEvent wake;
  reanalysis::Queue queue(factory.server.settings());
  if (const auto opened = queue.open(wake); !opened) throw std::runtime_error(opened.error().message);
  double identified_s = 0.0, read_s = 0.0;
  std::size_t counted = 0;
  for (const std::string& id : factory.server.column("SELECT id FROM clampd.checks ORDER BY id LIMIT 200")) {
    const double begin_s = cpu_of_this_thread_s();
    const auto check = value_of(queue.check(id));
    auto runs = value_of(reanalysis::unpack_runs(check));
    const double read_at_s = cpu_of_this_thread_s();
    reanalysis::analyse(check, std::move(runs), task, "", [] { return false; });
    read_s += read_at_s - begin_s;
    identified_s += cpu_of_this_thread_s() - read_at_s;
    ++counted;
  }
  const double checks = static_cast<double>(counted);
  fmt::print("a worker's processor time a check, in ms: identification {:.1f}, reading its runs {:.2f}\n",
             1e3 * identified_s / checks, 1e3 * read_s / checks);
  return read_s / checks;
}

void measure_rate(const PublishedFactory& factory, int workers, const WorkersShare& share) {
  factory.submit();
  const double server_s = cpu_of_server_s(factory.server), children_s = cpu_of_children_s();
  const Clock::time_point begin = Clock::now();
  factory.finish(workers);
  const double took_s = since_s(begin);
  const double checks = factory.checks();
  const double of_server_s = (cpu_of_server_s(factory.server) - server_s) / checks;
  const double of_workers_s = (cpu_of_children_s() - children_s) / checks;
  const double beside_s = of_server_s + share.reading_s + share.claiming_s;
  fmt::print(
      "{} workers: {} checks in {:.1f} s, {:.1f} a second; processor time a check: workers {:.1f} ms, "
      "PostgreSQL {:.2f} ms; queue and storage {:.1f} % of all; {}\n",
      workers, factory.checks(), took_s, checks / took_s, 1e3 * of_workers_s, 1e3 * of_server_s,
      100.0 * beside_s / (of_workers_s + of_server_s),
      factory.digest() == factory.reference() ? "the same results" : "OTHER RESULTS");
  std::fflush(stdout);
}

/// For a task from its claim to its result, without the work, where so many rows wait and were done. Returns
/// the worker's processor time, in s.
double measure_queue(const PublishedFactory& factory, int waiting, int done) {
  const support::Database& server = factory.server;
  factory.submit();
  const int jobs = (waiting + done + factory.checks() - 1) / factory.checks();
  server.ask("DELETE FROM clampd.queue");
  server.ask(fmt::format(
      "INSERT INTO clampd.jobs (name, task_sha256, selection) SELECT name, task_sha256, selection "
      "FROM clampd.jobs, generate_series(2, {})",
      jobs));
  server.ask(
      fmt::format("INSERT INTO clampd.queue (job_id, check_id, state) SELECT j.id, c.id, CASE WHEN "
                  "row_number() OVER () <= "
                  "{} THEN 'done' ELSE 'waiting' END FROM clampd.jobs j CROSS JOIN clampd.checks c LIMIT {}",
                  done, waiting + done));
  server.ask("ANALYZE clampd.queue");
  publish::WakeEvent wake;
  reanalysis::Queue queue(factory.server.settings());
  if (const auto opened = queue.open(wake); !opened) throw std::runtime_error(opened.error().message);
  constexpr int kTasks = 500;
  const double server_s = cpu_of_server_s(server), own_s = cpu_of_this_thread_s();
  const Clock::time_point begin = Clock::now();
  for (int task = 0; task < kTasks; ++task) {
    const auto claim = value_of(queue.claim("costs", 60s));
    if (value_of(queue.finish(claim.value(), "{}", "costs")) != reanalysis::Written::Yes)
      throw std::runtime_error("a claim was lost");
  }
  fmt::print(
      "queue with {} rows waiting and {} done: {:.2f} ms a task, {:.2f} ms of PostgreSQL's processor time\n",
      waiting, done, 1e3 * since_s(begin) / kTasks, 1e3 * (cpu_of_server_s(server) - server_s) / kTasks);
  return (cpu_of_this_thread_s() - own_s) / kTasks;
}

void measure_disk(const PublishedFactory& factory) {
  const double checks = factory.checks();
  const auto size = [&](const std::string& tables) {
    return std::stod(factory.server.ask("SELECT sum(pg_total_relation_size(oid)) FROM pg_class WHERE "
                                        "relnamespace = 'clampd'::regnamespace "
                                        "AND relkind = 'r' AND relname " +
                                        tables)) /
           checks / 1e3;
  };
  double stores = 0.0;
  for (const auto& entry : fs::directory_iterator(factory.path("factory")))
    if (entry.path().extension() == ".sqlite") stores += static_cast<double>(entry.file_size());
  fmt::print(
      "disk a check, in kB: raw runs {:.1f}, check with parameters and runs' figures {:.1f}, result {:.1f}, "
      "queue {:.2f}; the station's own store {:.1f}\n",
      size("LIKE 'raw_runs%'"), size("IN ('checks', 'parameters', 'runs')"), size("= 'results'"),
      size("= 'queue'"), stores / checks / 1e3);
}

void measure(int checks, int repeats) {
  double load[1] = {0.0};
  ::getloadavg(load, 1);
  fmt::print("{} processors, load {:.1f} as it begins; {} checks of {} repeats\n",
             std::thread::hardware_concurrency(), load[0], checks, repeats);
  PublishedFactory factory(checks, repeats);
  fmt::print("PostgreSQL's processor time to publish a check: {:.2f} ms\n",
             1e3 * cpu_of_server_s(factory.server) / checks);
  factory.make_reference();
  measure_disk(factory);
  WorkersShare share{reading_s(factory), measure_queue(factory, 1'000, 0)};
  measure_queue(factory, 100'000, 0);
  measure_queue(factory, 1'000, 99'000);
  for (const int workers : {1, 2, 1, 2}) measure_rate(factory, workers, share);
}

}  // namespace
}  // namespace clampd::factory

/// archive_costs [CHECKS [REPEATS]]
int main(int argc, char** argv) {
  clampd::factory::measure(argc > 1 ? std::atoi(argv[1]) : 400, argc > 2 ? std::atoi(argv[2]) : 3);
}
