#include "drivers/can/log_check.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"

namespace clampd::can {
namespace {

constexpr double kNearlyAll = 0.98;
constexpr double kPeriodTolerance = 0.1;

struct Named {
  const char* name;
  const char* unit;
  const FeedbackField ProtocolCodec::*field;
};

constexpr std::array kSignals{
    Named{"force", "N", &ProtocolCodec::force},     Named{"velocity", "rad/s", &ProtocolCodec::velocity},
    Named{"torque", "N m", &ProtocolCodec::torque}, Named{"position", "rad", &ProtocolCodec::position},
    Named{"enabled", "", &ProtocolCodec::enabled},  Named{"watchdog", "", &ProtocolCodec::watchdog},
    Named{"fault", "", &ProtocolCodec::fault}};

/// One frame of the mapping while the log is read.
struct Watched {
  const FrameLayout* layout = nullptr;
  std::vector<std::pair<std::size_t, Field>> fields;  ///< index of the finding's signal
  std::optional<std::uint32_t> last_counter;
  std::optional<std::int64_t> last_ns;
  std::vector<double> steps_ms;
  FrameFinding finding;
};

void count_counter(Watched& watched, const Frame& frame) {
  const FrameProtection& protection = watched.layout->protection;
  if (!protection.has_counter()) return;
  const std::uint32_t counter = protection.counter_of(frame);
  if (watched.last_counter) {
    const std::uint64_t ahead = protection.steps(*watched.last_counter, counter);
    watched.finding.counter_repeats += ahead == 0 ? 1 : 0;
    watched.finding.counter_jumps += ahead > 1 ? 1 : 0;
  }
  watched.last_counter = counter;
}

void count_time(Watched& watched, const LoggedFrame& logged) {
  if (!logged.time_ns) return;
  if (const auto before_ns = std::exchange(watched.last_ns, logged.time_ns))
    watched.steps_ms.push_back(static_cast<double>(*logged.time_ns - *before_ns) * 1e-6);
}

std::optional<Spacing> spacing_of(std::vector<double> steps_ms) {
  if (steps_ms.empty()) return std::nullopt;
  const auto middle = steps_ms.begin() + static_cast<std::ptrdiff_t>(steps_ms.size() / 2);
  std::nth_element(steps_ms.begin(), middle, steps_ms.end());
  const auto [least, most] = std::minmax_element(steps_ms.begin(), steps_ms.end());
  return Spacing{steps_ms.size(), *middle, *least, *most};
}

void take(Watched& watched, const LoggedFrame& logged) {
  FrameFinding& finding = watched.finding;
  const Frame& frame = logged.frame;
  ++finding.seen;
  count_time(watched, logged);
  const bool classic = watched.layout->format == FrameFormat::Classic;
  if (frame.size != watched.layout->size) {
    ++finding.wrong_size;
    ++finding.sizes[frame.size];
  } else if ((frame.format == FrameFormat::Classic) != classic) {
    ++finding.wrong_format;
  } else if (!watched.layout->intact(frame)) {
    ++finding.wrong_checksum;
  } else {
    count_counter(watched, frame);
    for (const auto& [signal, field] : watched.fields) {
      const double value = field.decode(frame);
      SignalFinding& seen = finding.signals[signal];
      if (!field.plausible(value)) {
        ++seen.implausible;
        continue;
      }
      seen.saturated += field.saturated(value) ? 1 : 0;
      seen.least = std::min(seen.least, value);
      seen.most = std::max(seen.most, value);
    }
  }
}

std::vector<Watched> watch(const Database& database, const ProtocolCodec& codec) {
  std::vector<Watched> all(1 + codec.feedback_frames);
  for (std::size_t i = 0; i < all.size(); ++i) {
    all[i].layout = i == 0 ? &codec.command : &codec.feedback[i - 1];
    const Message* message = database.find_message(all[i].layout->id);
    all[i].finding.message = message == nullptr ? "" : message->name;
    all[i].finding.id = all[i].layout->id;
    all[i].finding.from_brake = i > 0;
  }
  const auto add = [&](Watched& watched, const char* name, const char* unit, const Field& field) {
    watched.fields.emplace_back(watched.finding.signals.size(), field);
    watched.finding.signals.push_back({name, unit});
  };
  if (codec.commanded == CommandedQuantity::Velocity)
    add(all[0], "velocity command", "rad/s", codec.setpoint);
  else
    add(all[0], "torque command", "N m", codec.setpoint);
  for (const Named& signal : kSignals) {
    const FeedbackField& field = codec.*signal.field;
    if (field.present) add(all[1 + field.frame], signal.name, signal.unit, field.field);
  }
  return all;
}

/// The checksums that would fit all of a frame's content, judged by the frames of the right size.
std::vector<std::string> fitting_checksums(const FrameLog& log, const Message& message,
                                           const FrameLayout& layout, const ProtocolMapping& mapping) {
  std::vector<std::string> fitting;
  const auto counter = own_name(message, mapping.counter), crc = own_name(message, mapping.crc);
  if (!counter || !crc) return fitting;
  for (std::size_t i = 0; i < kChecksumNames.size(); ++i) {
    ProtectionDescription description;
    description.checksum = static_cast<Checksum>(i);
    if (description.checksum == mapping.protection.checksum || description.checksum == Checksum::None ||
        description.checksum == Checksum::Crc)
      continue;
    const auto protection = FrameProtection::build(message, *counter, *crc, description, message.name);
    if (!protection) continue;
    std::size_t tried = 0, matching = 0;
    for (const LoggedFrame& logged : log.frames) {
      if (!layout.is_meant_by(logged.frame) || logged.frame.size != layout.size) continue;
      ++tried;
      matching += protection->matches(logged.frame) ? 1 : 0;
    }
    if (static_cast<double>(matching) > kNearlyAll * static_cast<double>(tried))
      fitting.emplace_back(kChecksumNames[i]);
  }
  return fitting;
}

std::string sizes_text(const std::map<std::size_t, std::size_t>& sizes) {
  std::string text;
  for (const auto& [size, count] : sizes)
    text += fmt::format("{}{} bytes ({} times)", text.empty() ? "" : ", ", size, count);
  return text;
}

void judge_content(const FrameFinding& f, const FrameLayout& layout, const std::string& name,
                   LogFinding& finding) {
  const auto problem = [&](std::string text) { finding.problems.push_back(name + ": " + std::move(text)); };
  const auto share = [&](std::size_t count) {
    return 100.0 * static_cast<double>(count) / static_cast<double>(f.seen);
  };
  if (f.wrong_size > 0)
    problem(
        fmt::format("{} of {} frames have another size than the {} bytes of the DBC file: {}; correct its "
                    "message there",
                    f.wrong_size, f.seen, layout.size, sizes_text(f.sizes)));
  if (f.wrong_format > 0)
    problem(fmt::format(
        "{} of {} frames are {}, the DBC file says otherwise; its attribute VFrameFormat tells, 14 "
        "for CAN FD with 11 bits of identifier, 15 with 29",
        f.wrong_format, f.seen, layout.format == FrameFormat::Classic ? "CAN FD" : "classic frames"));
  if (f.wrong_checksum > 0 && !f.other_checksums.empty())
    problem(
        fmt::format("{:.1f} % of the checksums are wrong, but all are right by [can.protection] checksum = "
                    "\"{}\"",
                    share(f.wrong_checksum), f.other_checksums.front()));
  else if (f.wrong_checksum > 0)
    problem(fmt::format(
        "{:.1f} % of the checksums are wrong; ask the brake's maker for the algorithm and the data "
        "id, and describe them in [can.protection] and the attribute E2EDataId",
        share(f.wrong_checksum)));
  if (f.counter_repeats > 0)
    problem(fmt::format(
        "its counter repeats {} times: the station takes such a frame for a frozen one; have the brake count "
        "each frame that it sends",
        f.counter_repeats));
  if (f.counter_jumps > 0)
    finding.notes.push_back(
        fmt::format("{}: its counter jumps {} times; frames were lost, or the recording has gaps", name,
                    f.counter_jumps));
  for (const SignalFinding& signal : f.signals) {
    if (signal.implausible > 0)
      problem(fmt::format(
          "{} is outside of the DBC file's range in {} frames, which the station refuses: correct its "
          "range, scale, offset or byte order there if the brake is right",
          signal.name, signal.implausible));
    const bool measured = signal.name == "force" || signal.name == "velocity" || signal.name == "torque";
    if (f.from_brake && measured && signal.saturated > 0)
      problem(fmt::format(
          "{} stands at the end of the DBC file's range in {} frames, which the station refuses, since the "
          "true value may lie beyond: adjust the sensor, or correct the range there if the brake can tell "
          "more",
          signal.name, signal.saturated));
  }
}

void judge_absent(const FrameFinding& f, const FrameLayout& layout, const std::string& name,
                  LogFinding& finding) {
  auto& list = f.from_brake ? finding.problems : finding.notes;
  if (f.other_content > 0)
    list.push_back(fmt::format(
        "{}: of {} frames with its identifier none has {} bytes and the multiplexor's value by which the DBC "
        "file puts the mapped signals into it; correct it there, or map signals that the brake sends",
        name, f.other_content, layout.size));
  else if (f.from_brake)
    list.push_back(fmt::format(
        "{}: not in the log; without it no sample is complete: record while the brake sends it, or correct "
        "its identifier in the DBC file",
        name));
  else
    list.push_back(
        fmt::format("{}: not in the log; that is as it should be where no station was on the bus", name));
}

void judge_frame(const FrameFinding& f, const FrameLayout& layout, double cycle_ms, LogFinding& finding) {
  const std::string name = fmt::format("{} (0x{:X})", f.message, f.id & ~kExtendedId);
  if (f.seen == 0) {
    judge_absent(f, layout, name, finding);
    return;
  }
  judge_content(f, layout, name, finding);
  if (!f.from_brake) return;
  if (!f.spacing) {
    finding.notes.push_back(fmt::format("{}: how often it comes, this log does not tell", name));
  } else if (std::abs(f.spacing->median_ms - cycle_ms) > kPeriodTolerance * cycle_ms) {
    finding.problems.push_back(fmt::format(
        "{}: comes every {:.2f} ms; the station needs a sample every {:g} ms: have the brake send it so "
        "often ([can] feedback_cycle_ms takes 5, 2, 1, 0.5, 0.25 and 0.2)",
        name, f.spacing->median_ms, cycle_ms));
  }
}

void count_samples(const FrameLog& log, const ProtocolCodec& codec, LogFinding& finding) {
  StationProtocol station(codec);
  std::int64_t now_ns = 0;
  for (const LoggedFrame& logged : log.frames) {
    // Without time stamps, frames are a tenth of a cycle apart: near enough to belong together.
    now_ns = logged.time_ns ? *logged.time_ns : now_ns + codec.feedback_cycle_ns() / 10;
    if (station.accept(logged.frame, now_ns)) ++finding.samples;
  }
  finding.counts = station.counts();
  finding.arrival_jitter_ms = station.arrival_jitter_ns() * 1e-6;
}

void judge_clocked_samples(LogFinding& finding) {
  if (finding.samples == 0)
    finding.problems.emplace_back(
        "no sample is complete: the frames of one sample must carry the same counter, and come together");
  else if (const std::size_t refused = finding.counts.counter_errors; refused > 0)
    finding.problems.push_back(
        fmt::format("{} samples are refused since counter and sample clock contradict each other: the clock "
                    "must go on by one period with each count",
                    refused));
}

void judge_arrivals(bool counted, std::size_t frames, double cycle_ms, LogFinding& finding) {
  if (finding.samples == 0) {
    const std::string together =
        counted || frames == 1
            ? ""
            : fmt::format("; without a counter the {} frames of each have to come within {:g} ms", frames,
                          0.5 * cycle_ms);
    finding.problems.push_back(
        fmt::format("no sample has a time: without a sample clock, {} samples{}, every {:g} ms within {:g} "
                    "%, have to come first{}",
                    ArrivalClock::kSettlingSamples, counted ? ", one with each count" : " without a gap",
                    cycle_ms, 100.0 * ArrivalClock::kPeriodTolerance, together));
    return;
  }
  if (const std::size_t refused = finding.counts.counter_errors; refused > 0)
    finding.problems.push_back(fmt::format(
        "{} samples are refused since they come far from their time, by the others: half a "
        "period early, or one and a half late. Does the brake sample evenly, and what goes before "
        "it on the bus?",
        refused));
  finding.notes.push_back(
      fmt::format("without a sample clock, times are told by the arrivals, which vary by {:.3f} ms "
                  "(standard deviation); the first {} samples serve to find the period",
                  finding.arrival_jitter_ms, ArrivalClock::kSettlingSamples));
}

void judge_samples(const ProtocolCodec& codec, bool stamped, LogFinding& finding) {
  const bool counted = codec.feedback.front().protection.has_counter();
  if (codec.sample_clock.present)
    judge_clocked_samples(finding);
  else if (!stamped)
    finding.problems.emplace_back(
        "without a sample clock the frames' time stamps are needed, and this log has none: record it with "
        "candump -l");
  else
    judge_arrivals(counted, codec.feedback_frames, codec.feedback_cycle_ms(), finding);
  if (!codec.sample_clock.present && !counted)
    finding.notes.emplace_back(
        "neither sample clock nor alive counter: a sample that is held up counts as lost, and so does the "
        "first one after a gap; that frames are sent again and again, only the readings tell, while a check "
        "drives the brake");
}

}  // namespace

void note_demands(const ProtocolCodec& codec, const Demands& demands, LogFinding& finding) {
  const auto note = [&](const std::string& name, const char* unit, const Field& field, const Demand& demand) {
    const bool limited = demand.least < demand.most;
    if (limited && (field.minimum() > demand.least || field.maximum() < demand.most))
      finding.notes.push_back(fmt::format(
          "{}: the DBC file lets it be {:g} to {:g} {}, less than the {:g} to {:g} {} that the station's "
          "limits allow: checks that go further end in an ERROR; correct its range there if the brake can do "
          "more",
          name, field.minimum(), field.maximum(), unit, demand.least, demand.most, unit));
    if (0.5 * field.step() > demand.mismatch)
      finding.notes.push_back(
          fmt::format("{}: its steps in the DBC file are {:g} {}, but readings that are {:g} {} apart "
                      "contradict each other to the supervisor: without finer steps checks may end in an "
                      "ERROR",
                      name, field.step(), unit, demand.mismatch, unit));
  };
  const bool by_speed = codec.commanded == CommandedQuantity::Velocity;
  note(by_speed ? "velocity command" : "torque command", by_speed ? "rad/s" : "N m", codec.setpoint,
       by_speed ? demands.velocity : demands.torque);
  note("force", "N", codec.force.field, demands.force);
  note("velocity", "rad/s", codec.velocity.field, demands.velocity);
  note("torque", "N m", codec.torque.field, demands.torque);
  note("position", "rad", codec.position.field, demands.position);
}

std::map<std::uint32_t, OtherFrame> identifiers(const FrameLog& log, const Database& database) {
  std::map<std::uint32_t, OtherFrame> all;
  for (const LoggedFrame& logged : log.frames) {
    OtherFrame& other = all[logged.frame.id];
    if (other.seen++ == 0)
      if (const Message* message = database.find_message(logged.frame.id)) other.message = message->name;
  }
  return all;
}

LogFinding check_log(const FrameLog& log, const Database& database, const ProtocolMapping& mapping,
                     const ProtocolCodec& codec) {
  LogFinding finding;
  std::vector<Watched> watched = watch(database, codec);
  finding.others = identifiers(log, database);
  for (const auto& ids : {codec.command_ids(), codec.feedback_ids()})
    for (const std::uint32_t id : ids) finding.others.erase(id);
  for (const LoggedFrame& logged : log.frames)
    for (Watched& frame : watched)
      if (frame.layout->is_meant_by(logged.frame))
        take(frame, logged);
      else
        frame.finding.other_content += frame.layout->id == logged.frame.id ? 1 : 0;
  count_samples(log, codec, finding);
  const LoggedFrame &first = log.frames.front(), &last = log.frames.back();
  if (first.time_ns && last.time_ns)
    finding.duration_s = static_cast<double>(*last.time_ns - *first.time_ns) * 1e-9;
  for (Watched& frame : watched) {
    FrameFinding& f = frame.finding;
    f.spacing = spacing_of(std::move(frame.steps_ms));
    const Message* message = database.find_message(f.id);
    if (message != nullptr && 2 * f.wrong_checksum > f.seen)
      f.other_checksums = fitting_checksums(log, *message, *frame.layout, mapping);
    judge_frame(f, *frame.layout, codec.feedback_cycle_ms(), finding);
    finding.frames.push_back(std::move(f));
  }
  const bool all_seen = std::all_of(finding.frames.begin(), finding.frames.end(),
                                    [](const FrameFinding& f) { return !f.from_brake || f.good() > 1; });
  if (all_seen) judge_samples(codec, first.time_ns.has_value(), finding);
  return finding;
}

}  // namespace clampd::can
