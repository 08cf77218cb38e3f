#include "tests/support/blind/blind_set.hpp"

#include <algorithm>
#include <filesystem>
#include <map>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/base/assert.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/simulation/simulate.hpp"
#include "tests/support/blind/draw.hpp"

namespace clampd::blind {
namespace {

namespace fs = std::filesystem;

struct Part {
  std::string_view manoeuvre;
  int runs;
};
constexpr Part kFullSet[] = {
    {"optimal", 6}, {"apply-release", 3}, {"sinusoid", 2}, {"staircase", 2}, {"clearance", 2}};

struct Drivable {
  Run trajectory;
  Reference reference;
};

/// Of the nominal brake; made once.
const Drivable& drivable(const std::string& manoeuvre) {
  static const std::map<std::string, Drivable, std::less<>> kAll = [] {
    const Run optimal = read_run(std::string(CLAMPD_SOURCE_DIR) + "/configs/trajectory.csv").value().run;
    std::map<std::string, Drivable, std::less<>> all;
    for (const Part& part : kFullSet) {
      Run trajectory = make_manoeuvre(part.manoeuvre, BrakeParameters{}, optimal).value();
      Reference reference = build_reference(trajectory, BrakeParameters{}).value();
      all.emplace(part.manoeuvre, Drivable{std::move(trajectory), std::move(reference)});
    }
    return all;
  }();
  return kAll.at(manoeuvre);
}

/// As wide as the paper's Table II and a little wider; `extreme`: a parameter lies at an end of its range as
/// often as within it.
BrakeParameters draw_brake(bool extreme, Draw& draw) {
  constexpr double kLower[kParameterCount] = {0.76, 0.88, 0.85, 0.85, 0.8, 0.85, 0.38};
  constexpr double kUpper[kParameterCount] = {1.05, 1.06, 1.8, 1.15, 2.5, 1.1, 1.2};
  BrakeParameters brake;
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    double factor = draw.log_uniform(kLower[i], kUpper[i]);
    if (extreme && draw.chance(0.5)) factor = draw.chance(0.5) ? kLower[i] : kUpper[i];
    brake.theta[static_cast<Eigen::Index>(i)] *= factor;
  }
  return brake;
}

/// From a soft loop to one about as stiff as its noise and delay allow.
Feedback draw_feedback(Draw& draw) {
  Feedback feedback;
  feedback.position_Nm_rad = draw.log_uniform(1.0, 4.0);
  feedback.velocity_Nm_s_rad = draw.log_uniform(0.02, 0.06);
  if (draw.chance(0.5)) feedback.force_Nm_N = draw.log_uniform(5e-5, 5e-4);
  if (draw.chance(1.0 / 3.0))
    feedback.per_row = 10;
  else
    feedback.delay_rows = draw.integer(0, 2);
  return feedback;
}

std::vector<std::string> draw_manoeuvres(bool reduced, Draw& draw) {
  std::vector<std::string> all;
  for (const Part& part : kFullSet) {
    const int runs = reduced && draw.chance(0.5) ? 0 : reduced ? draw.integer(1, part.runs) : part.runs;
    all.insert(all.end(), static_cast<std::size_t>(runs), std::string(part.manoeuvre));
  }
  if (all.empty()) all.emplace_back("optimal");
  return all;
}

/// Seeds of the plants, apart from the answer's own.
std::uint64_t mixed(std::uint64_t seed, std::uint64_t of) {
  std::uint64_t z = seed + (of + 1) * 0x9e3779b97f4a7c15u;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}

std::uint64_t seed_of(const Request& request) {
  return mixed(request.seed, static_cast<std::uint64_t>(request.kind) * 2 +
                                 static_cast<std::uint64_t>(request.generator) +
                                 (request.feedback ? 1000 : 0));
}

void name_runs(BlindSet& set) {
  for (std::vector<Run>* runs : {&set.runs, &set.noise_free})
    for (std::size_t i = 0; i < runs->size(); ++i)
      (*runs)[i].name = fmt::format("run-{:02}-{}.csv", i + 1, set.answer.manoeuvres[i]);
}

BlindSet simulate_independent(const Answer& answer) {
  Physics physics;
  physics.brake = answer.brake;
  physics.noise = answer.noise;
  physics.feedback = answer.feedback;
  for (const HiddenEffect& effect : answer.effects) effect.onto_physics(physics);
  HiddenPlant plant(physics, mixed(seed_of(answer.request), 1));
  // Half of the rigs have no encoder.
  const bool encoder = mixed(seed_of(answer.request), 2) % 2 == 0;
  BlindSet set{answer, {}, {}};
  for (std::size_t i = 0; i < answer.manoeuvres.size(); ++i) {
    HiddenPlant::Recording recording =
        plant.record(drivable(answer.manoeuvres[i]).trajectory, static_cast<int>(i));
    if (!encoder) recording.readings.position_rad.clear();
    set.runs.push_back(std::move(recording.readings));
    set.noise_free.push_back(std::move(recording.noise_free));
  }
  return set;
}

Result<std::vector<Run>> drive_station(const Answer& answer, bool noise) {
  const std::uint64_t seed = seed_of(answer.request);
  sim::PlantConfiguration plant;
  plant.brake = answer.brake;
  plant.encoder_zero_rad = static_cast<double>(mixed(seed, 3) % 1000) * 0.1;
  for (const HiddenEffect& effect : answer.effects) effect.onto_effects(plant.effects);
  if (noise) {
    plant.sensors.force_noise_N = answer.noise.sensors.force_N;
    plant.sensors.velocity_noise_rad_s = answer.noise.sensors.velocity_rad_s;
    plant.sensors.torque_noise_Nm = answer.noise.torque_Nm;
    plant.sensors.force_quantum_N = 1.0;
    plant.sensors.velocity_quantum_rad_s = 0.02;
    plant.sensors.torque_quantum_Nm = 1e-4;
  }
  plant.sensors.position_quantum_rad = 1e-3;
  std::vector<Run> all;
  while (all.size() < answer.manoeuvres.size()) {
    const std::string& manoeuvre = answer.manoeuvres[all.size()];
    std::uint16_t repeats = 1;
    while (all.size() + repeats < answer.manoeuvres.size() &&
           answer.manoeuvres[all.size() + repeats] == manoeuvre)
      ++repeats;
    plant.seed = mixed(seed, 16 + all.size());
    const SimulationOptions options{.repeats = repeats, .first_run = static_cast<std::uint32_t>(all.size())};
    SimulatedCheck check = simulate_check(plant, drivable(manoeuvre).reference, BrakeParameters{}, options);
    if (check.fault != FaultCause::None)
      return failure(fmt::format("the station stopped {}: {}", manoeuvre, to_string(check.fault)));
    for (SimulatedRun& run : check.runs) all.push_back(std::move(run.readings));
  }
  return all;
}

}  // namespace

std::string_view to_string(Kind kind) noexcept {
  constexpr std::string_view kNames[] = {"none", "single", "offlist", "pair"};
  return kNames[static_cast<int>(kind)];
}

std::string_view to_string(Generator generator) noexcept {
  return generator == Generator::Station ? "station" : "independent";
}

std::vector<std::string_view> effect_names(bool on_list, Generator generator) {
  CLAMPD_ASSERT(on_list || generator == Generator::Independent);
  std::vector<std::string_view> names;
  for (const EffectKind& kind : effect_kinds())
    if (kind.on_list == on_list) names.push_back(kind.name);
  return names;
}

Answer draw_answer(const Request& request) {
  CLAMPD_ASSERT(!request.feedback || request.generator == Generator::Independent);
  Draw draw(seed_of(request));
  Answer answer;
  answer.request = request;
  answer.brake = draw_brake(request.feedback, draw);
  if (request.feedback) answer.feedback = draw_feedback(draw);
  answer.noise.sensors = {.force_N = draw.uniform(30.0, 75.0), .velocity_rad_s = draw.uniform(0.3, 1.5)};
  answer.noise.torque_Nm = draw.uniform(0.005, 0.014);
  answer.manoeuvres = draw_manoeuvres(request.reduced, draw);
  if (request.kind == Kind::None) return answer;

  const std::vector<std::string_view> names = effect_names(request.kind != Kind::OffList, request.generator);
  const std::size_t wanted = request.kind == Kind::Pair ? 2 : 1;
  while (answer.effects.size() < wanted) {
    std::string_view name =
        names[static_cast<std::size_t>(draw.integer(0, static_cast<int>(names.size()) - 1))];
    if (answer.effects.empty() && !request.effect.empty()) name = request.effect;
    if (!answer.effects.empty() && answer.effects.front().name == name) continue;
    const auto kinds = effect_kinds();
    const auto kind =
        std::find_if(kinds.begin(), kinds.end(), [&](const EffectKind& k) { return k.name == name; });
    CLAMPD_ASSERT(kind != kinds.end());
    HiddenEffect effect =
        request.generator == Generator::Station ? draw_station_effect(name, draw) : kind->draw(draw);
    effect.name = name;
    answer.effects.push_back(std::move(effect));
  }
  return answer;
}

Result<BlindSet> simulate(const Answer& answer) {
  BlindSet set;
  if (answer.request.generator == Generator::Independent) {
    set = simulate_independent(answer);
  } else {
    Result<std::vector<Run>> runs = drive_station(answer, true);
    if (!runs) return tl::unexpected(runs.error());
    // The controller sees the noise, so that these are not the same motions; but the same for scoring.
    Result<std::vector<Run>> noise_free = drive_station(answer, false);
    if (!noise_free) return tl::unexpected(noise_free.error());
    set = {answer, std::move(*runs), std::move(*noise_free)};
  }
  name_runs(set);
  return set;
}

Result<BlindSet> make_set(const Request& request) {
  constexpr int kAttempts = 8;
  Request next = request;
  Result<BlindSet> set = simulate(draw_answer(next));
  for (int attempt = 1; attempt < kAttempts && !set; ++attempt) {
    next.seed = mixed(request.seed, 100 + static_cast<std::uint64_t>(attempt));
    set = simulate(draw_answer(next));
  }
  return set;
}

Result<std::vector<std::string>> write_runs(const std::vector<Run>& runs, const std::string& folder) {
  std::error_code failed;
  fs::create_directories(folder, failed);
  if (failed) return failure(fmt::format("cannot create the folder {}: {}", folder, failed.message()));
  std::vector<std::string> paths;
  for (const Run& run : runs) {
    paths.push_back((fs::path(folder) / run.name).string());
    if (const Result<void> written = write_run(paths.back(), run); !written)
      return tl::unexpected(written.error());
  }
  return paths;
}

std::string answer_json(const Answer& answer) {
  nlohmann::ordered_json json;
  json["kind"] = to_string(answer.request.kind);
  json["generator"] = to_string(answer.request.generator);
  json["seed"] = answer.request.seed;
  json["effects"] = nlohmann::ordered_json::array();
  for (const HiddenEffect& effect : answer.effects) {
    nlohmann::ordered_json entry{{"name", effect.name}, {"form", effect.form}};
    for (const auto& [name, value] : effect.values) entry["values"][name] = value;
    entry["locations"] = effect.locations;
    json["effects"].push_back(std::move(entry));
  }
  for (std::size_t i = 0; i < kParameterCount; ++i)
    json["parameters"][std::string(kParameterTable[i].name)] =
        answer.brake.theta[static_cast<Eigen::Index>(i)];
  if (const Feedback& feedback = answer.feedback; feedback.is_on())
    json["feedback"] = {{"position_Nm_rad", feedback.position_Nm_rad},
                        {"velocity_Nm_s_rad", feedback.velocity_Nm_s_rad},
                        {"force_Nm_N", feedback.force_Nm_N},
                        {"per_row", feedback.per_row},
                        {"delay_rows", feedback.delay_rows}};
  json["noise"] = {{"force_N", answer.noise.sensors.force_N},
                   {"velocity_rad_s", answer.noise.sensors.velocity_rad_s},
                   {"torque_Nm", answer.noise.torque_Nm}};
  json["manoeuvres"] = answer.manoeuvres;
  return json.dump(2);
}

}  // namespace clampd::blind
