// The protocol of start, stop, clear, press, open and restart, as a small model against the real core and the
// real conductor in virtual time: every order of up to five steps, and random orders of many.

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <random>
#include <set>
#include <span>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "clampd/bench/check_conductor.hpp"
#include "drivers/gpio/panel_logic.hpp"
#include "rt/toy_station.hpp"

namespace clampd::bench {
namespace {

enum class Step : std::uint8_t {
  Ask,      ///< somebody asks for a check; it is on its way
  Deliver,  ///< and arrives
  Stop,
  Clear,
  Press,  ///< of the start button
  Serve,  ///< somebody looks whether it was pressed
  Open,
  Tick,
  Ticks,
  Pump,
  Restart,
};
constexpr int kSteps = 11;
constexpr const char* kNames[kSteps] = {"ask",  "deliver", "stop",  "clear", "press",  "serve",
                                        "open", "tick",    "ticks", "pump",  "restart"};

/// The brake's side of the station.
class Rig {
 public:
  virtual ~Rig() = default;
  virtual BrakePort& port() = 0;
  virtual void sample(std::int64_t now_ns) = 0;
};

/// Stands still, so that a check never gets beyond its approach, but an opening ends at once.
class ToyRig final : public Rig {
 public:
  BrakePort& port() override { return port_; }
  void sample(std::int64_t) override {}

 private:
  rt::test::ToyPort port_;
};

class SimulatedRig final : public Rig {
 public:
  explicit SimulatedRig(const PreparedStation& station)
      : bus_(static_cast<double>(station.configuration.can.bitrate)),
        port_(bus_.end(can::EmbeddedBus::End::Station), station.codec),
        brake_(bus_.end(can::EmbeddedBus::End::Brake), station.codec, plant(1), nullptr) {}
  BrakePort& port() override { return port_; }
  void sample(std::int64_t now_ns) override { brake_.tick(now_ns, 0, 0); }

 private:
  can::EmbeddedBus bus_;
  can::CanBrake port_;
  plant::Plant brake_;
};

/// Sees what leaves the station.
class Tap final : public BrakePort {
 public:
  explicit Tap(BrakePort& port) : port_(port) {}
  std::size_t receive(std::span<BrakeFeedback> out, std::int64_t now_ns) noexcept override {
    return port_.receive(out, now_ns);
  }
  bool send(const DriveCommand& command, std::int64_t now_ns) noexcept override {
    last = command;
    return port_.send(command, now_ns);
  }
  PortHealth health() const noexcept override { return port_.health(); }

  DriveCommand last;

 private:
  BrakePort& port_;
};

/// What all worlds together went through: a model in which nothing happens proves nothing.
struct Tally {
  int driven = 0;
  int passed = 0;
  int opened = 0;
  int aborted = 0;
  int refused = 0;
  std::set<std::string> ids;
  std::int64_t worlds = 0;  ///< each begins at a time of its own, as ids do
};

/// The station and all who want something of it.
class World {
 public:
  World(const PreparedStation& station, std::unique_ptr<Rig> rig, Tally& tally)
      : station_(station),
        rig_(std::move(rig)),
        tap_(rig_->port()),
        tally_(tally),
        now_ns_((1 + 100 * tally.worlds++) * kNanosecondsPerSecond) {
    start_station();
    ticks(40);
  }

  /// False if there was nothing to do for this step.
  bool take(Step step, int many_ticks) {
    ++clock_;
    switch (step) {
      case Step::Ask:
        asked_ = {core_->ticket(), clock_};
        return true;
      case Step::Deliver:
        if (!asked_) return false;
        begin(asked_->ticket, asked_->at);
        asked_.reset();
        return true;
      case Step::Stop:
        last_stop_ = clock_;
        if (under_way()) stopped_ = true;
        core_->requests().stop(now_ns_);
        return true;
      case Step::Clear:
        if (!core_->status().clearable) return false;
        core_->requests().clear = true;
        return true;
      case Step::Press:
        press_->note(now_ns_);
        pressed_at_ = clock_;
        return true;
      case Step::Serve:
        return serve();
      case Step::Open:
        if (conductor_->open(core_->ticket(), {now_ns_, now_ns_})) start_is_of(clock_);
        return true;
      case Step::Tick:
        ticks(1);
        return true;
      case Step::Ticks:
        ticks(many_ticks);
        return true;
      case Step::Pump:
        pump();
        return true;
      case Step::Restart:
        restart();
        return true;
    }
    return false;
  }

  /// Whatever is under way comes to its end.
  void settle() {
    core_->requests().stop(now_ns_);
    last_stop_ = ++clock_;
    if (under_way()) stopped_ = true;
    ticks(2);
    pump();
    EXPECT_FALSE(conductor_->busy());
  }

 private:
  struct Asked {
    rt::StartTicket ticket;
    std::uint64_t at = 0;
  };

  void start_station() {
    press_ = std::make_unique<gpio::StartPress>();
    core_ = std::make_unique<rt::ControlCore>(tap_, station_.supervisor, 4096);
    conductor_ = std::make_unique<CheckConductor>(station_, *core_, nullptr, WorkerMode::Synchronous);
  }

  bool under_way() const { return conductor_->busy() && core_->status().checks_finished == finished_before_; }

  void start_is_of(std::uint64_t asked_at) {
    driven_by_ = asked_at;
    finished_before_ = core_->status().checks_finished;
    stopped_ = false;
  }

  void begin(const rt::StartTicket& ticket, std::uint64_t asked_at) {
    if (!conductor_->begin(request(1), ticket, {now_ns_, now_ns_})) {
      ++tally_.refused;
      return;
    }
    EXPECT_TRUE(tally_.ids.insert(conductor_->id()).second) << "an id came twice";
    start_is_of(asked_at);
  }

  /// As the daemon does it.
  bool serve() {
    const auto press = press_->take(now_ns_);
    if (!press) return false;
    if (const auto ticket = core_->ticket_of(press->stamp_ns)) begin(*ticket, pressed_at_);
    return true;
  }

  void ticks(int count) {
    for (int i = 0; i < count; ++i) {
      rig_->sample(now_ns_);
      core_->tick(now_ns_ + kPeriod_ns / 2, 0, 0);
      now_ns_ += kPeriod_ns;
      EXPECT_EQ(core_->status().stops, core_->requests().stops) << "confirmed by the next tick";
      if (!tap_.last.enable) continue;
      ++tally_.driven;
      EXPECT_GT(driven_by_, last_stop_) << "motion that was asked for before the last stop";
    }
  }

  void pump() {
    const bool opened_before = conductor_->opening().under_way;
    if (const std::optional<CheckRecord> record = conductor_->pump({now_ns_, now_ns_})) judge(*record);
    if (opened_before && !conductor_->opening().under_way) {
      const bool open = conductor_->opening().verdict == Verdict::Pass;
      EXPECT_FALSE(open && stopped_) << "an opening that was stopped is said to have opened";
      tally_.opened += open ? 1 : 0;
    }
  }

  void judge(const CheckRecord& record) {
    EXPECT_EQ(record.id, conductor_->id());
    if (record.verdict == Verdict::Pass) ++tally_.passed;
    if (!stopped_) return;
    ++tally_.aborted;
    EXPECT_EQ(record.verdict, Verdict::Aborted) << record.reason;
    EXPECT_TRUE(record.fault == FaultCause::OperatorStop || record.fault == FaultCause::StationEnded);
  }

  void restart() {
    if (under_way()) stopped_ = true;
    core_->shutdown(now_ns_);
    EXPECT_FALSE(tap_.last.enable);
    pump();
    asked_.reset();
    driven_by_ = 0;
    last_stop_ = ++clock_;
    conductor_.reset();
    start_station();
  }

  const PreparedStation& station_;
  std::unique_ptr<Rig> rig_;
  Tap tap_;
  Tally& tally_;
  std::unique_ptr<rt::ControlCore> core_;
  std::unique_ptr<CheckConductor> conductor_;
  std::unique_ptr<gpio::StartPress> press_;
  std::optional<Asked> asked_;
  std::int64_t now_ns_;
  std::uint64_t clock_ = 0;  ///< orders the steps; 0: before all of them
  std::uint64_t last_stop_ = 0;
  std::uint64_t pressed_at_ = 0;
  std::uint64_t driven_by_ = 0;  ///< when the start that drives now was asked for
  std::uint64_t finished_before_ = 0;
  bool stopped_ = false;  ///< the check or opening under way, before it ended
};

PreparedStation short_check_station() {
  StationConfiguration configuration;
  configuration.check.tare_s = 0.05;
  configuration.check.repeats = 1;
  Result<PreparedStation> station = prepare_station(configuration);
  EXPECT_TRUE(station);
  return std::move(*station);
}

/// A brake without physics cannot be held to them.
PreparedStation toy_station() {
  PreparedStation station = short_check_station();
  station.supervisor.readings = {1e6, 1e6, 1e6, 1e9};
  return station;
}

std::string text(const std::vector<Step>& steps) {
  std::string line;
  for (const Step step : steps) line += std::string(kNames[static_cast<int>(step)]) + " ";
  return line;
}

/// Every order of `depth` steps after `prefix`; steps with nothing to do are left out with all that follows
/// them.
void explore(const std::vector<Step>& prefix, int depth, const PreparedStation& station, Tally& tally,
             int& orders) {
  std::vector<int> digits(static_cast<std::size_t>(depth), 0);
  while (true) {
    std::vector<Step> steps = prefix;
    for (const int digit : digits) steps.push_back(static_cast<Step>(digit));
    World world(station, std::make_unique<ToyRig>(), tally);
    std::size_t idle = steps.size();
    for (std::size_t i = 0; i < steps.size() && idle == steps.size(); ++i)
      if (!world.take(steps[i], 35)) idle = i;
    world.settle();
    ASSERT_FALSE(::testing::Test::HasFailure()) << text(steps);
    ++orders;
    int at = std::min(static_cast<int>(idle - prefix.size()), depth - 1);
    std::fill(digits.begin() + at + 1, digits.end(), 0);
    while (at >= 0 && ++digits[static_cast<std::size_t>(at)] == kSteps)
      digits[static_cast<std::size_t>(at--)] = 0;
    if (at < 0) return;
  }
}

TEST(StopProtocol, HoldsInEveryOrderOfAFewSteps) {
  const PreparedStation station = toy_station();
  Tally tally;
  int orders = 0;
  using enum Step;
  const std::vector<Step> beginnings[] = {{},
                                          {Ask},
                                          {Ask, Deliver, Tick},
                                          {Ask, Deliver, Ticks},
                                          {Open, Ticks},
                                          {Ask, Deliver, Ticks, Stop, Tick}};
  for (const std::vector<Step>& beginning : beginnings) explore(beginning, 4, station, tally, orders);
  EXPECT_GT(orders, 5'000);
  EXPECT_GT(tally.driven, 10'000);
  EXPECT_GT(tally.aborted, 1'000);
  EXPECT_GT(tally.opened, 10);
  EXPECT_GT(tally.refused, 100);
  RecordProperty("orders", orders);
}

/// `longest` in ticks at once; the weights let a check come to something now and then.
void wander(World& world, std::mt19937& random, int steps, int longest) {
  std::discrete_distribution<int> step({4, 4, 1, 4, 1, 2, 1, 2, 8, 4, 0.3});
  std::uniform_int_distribution<int> ticks(1, longest);
  std::vector<Step> taken;
  for (int i = 0; i < steps; ++i) {
    taken.push_back(static_cast<Step>(step(random)));
    world.take(taken.back(), ticks(random));
    ASSERT_FALSE(::testing::Test::HasFailure()) << text(taken);
  }
  world.settle();
}

TEST(StopProtocol, HoldsInAThousandRandomOrders) {
  const PreparedStation station = toy_station();
  Tally tally;
  std::mt19937 random(2026'11'23);
  for (int i = 0; i < 1'000 && !HasFailure(); ++i) {
    World world(station, std::make_unique<ToyRig>(), tally);
    wander(world, random, 80, 120);
  }
  EXPECT_GT(tally.opened, 100);
  EXPECT_GT(tally.aborted, 100);
}

TEST(StopProtocol, HoldsWithABrakeThatMoves) {
  const PreparedStation station = short_check_station();
  Tally tally;
  std::mt19937 random(7);
  for (int i = 0; i < 60 && !HasFailure(); ++i) {
    World world(station, std::make_unique<SimulatedRig>(station), tally);
    wander(world, random, 60, 900);
  }
  EXPECT_GT(tally.passed, 10);
  EXPECT_GT(tally.aborted, 10);
}

/// Stop and clear right after each other, anywhere in the end of a check, and only then does anybody look.
TEST(StopProtocol, AClearRightAfterAStopTurnsNoCheckIntoAPass) {
  const PreparedStation station = short_check_station();
  const auto run = [&](int stop_at, int& length) {
    SimulatedRig rig(station);
    rt::ControlCore core(rig.port(), station.supervisor);
    CheckConductor conductor(station, core, nullptr, WorkerMode::Synchronous);
    std::int64_t now_ns = 0;
    const auto tick = [&] {
      rig.sample(now_ns);
      core.tick(now_ns + kPeriod_ns / 2, 0, 0);
      now_ns += kPeriod_ns;
    };
    while (core.status().state != StationState::Idle) tick();
    EXPECT_TRUE(conductor.begin(request(1), {now_ns, now_ns}));
    for (length = 0; length != stop_at && core.status().checks_finished == 0; ++length) tick();
    const bool ended_before = core.status().checks_finished != 0;
    core.requests().stop(now_ns);
    tick();
    core.requests().clear = true;
    tick();
    EXPECT_NE(core.status().state, StationState::Fault);
    const std::optional<CheckRecord> record = conductor.pump({now_ns, now_ns});
    EXPECT_TRUE(record);
    EXPECT_EQ(record->verdict, ended_before ? Verdict::Pass : Verdict::Aborted) << stop_at << record->reason;
    EXPECT_EQ(record->fault, ended_before ? FaultCause::None : FaultCause::OperatorStop);
  };
  int whole = 0;
  run(-1, whole);
  for (int before_end = 40; before_end >= 0 && !HasFailure(); --before_end) {
    int length = 0;
    run(whole - before_end, length);
  }
}

}  // namespace
}  // namespace clampd::bench
