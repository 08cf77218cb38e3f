#include "drivers/can/codec.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <optional>
#include <string_view>
#include <utility>

#include "clampd/base/clock.hpp"

namespace clampd::can {
namespace {

struct Unit {
  std::string_view name;
  double si;  ///< SI value of one
};

constexpr Unit kForceUnits[]{{"N", 1.0}, {"kN", 1e3}};
constexpr Unit kTorqueUnits[]{{"Nm", 1.0}, {"N m", 1.0}, {"N*m", 1.0}, {"mNm", 1e-3}};
constexpr Unit kVelocityUnits[]{{"rad/s", 1.0},
                                {"rpm", std::numbers::pi / 30.0},
                                {"RPM", std::numbers::pi / 30.0},
                                {"1/min", std::numbers::pi / 30.0},
                                {"deg/s", std::numbers::pi / 180.0},
                                {"deg/sec", std::numbers::pi / 180.0}};
constexpr Unit kAngleUnits[]{{"rad", 1.0},
                             {"mrad", 1e-3},
                             {"deg", std::numbers::pi / 180.0},
                             {"Deg", std::numbers::pi / 180.0},
                             {"degree", std::numbers::pi / 180.0},
                             {"degrees", std::numbers::pi / 180.0}};
constexpr Unit kTimeUnits[]{{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}};
/// What files write of signals that have none.
constexpr Unit kFlagUnits[]{{"", 1.0},         {"-", 1.0},        {"SED", 1.0},
                            {"unitless", 1.0}, {"Unitless", 1.0}, {"Enum", 1.0}};

struct Place {
  const Message* message = nullptr;
  const Signal* signal = nullptr;
};

std::string names_of(const Message& message) {
  std::string names;
  for (const Signal& signal : message.signals) names += (names.empty() ? "" : ", ") + signal.name;
  return names;
}

Result<Place> find(const Database& database, std::string_view what, const std::string& place) {
  const std::size_t dot = place.find('.');
  if (dot == std::string::npos || dot == 0 || dot + 1 == place.size()) {
    return failure(
        fmt::format("{}: '{}' must read Message.Signal, e.g. BrakeFeedback.Force, of {}; correct it in "
                    "[can.mapping]",
                    what, place, database.file));
  }
  const Message* message = database.find_message(std::string_view{place}.substr(0, dot));
  if (message == nullptr) {
    return failure(fmt::format("{}: there is no message {} in {}; correct the name there or in [can.mapping]",
                               what, place.substr(0, dot), database.file));
  }
  const Signal* signal = message->find_signal(std::string_view{place}.substr(dot + 1));
  if (signal == nullptr) {
    return failure(
        fmt::format("{}: message {} of {} has no signal {}; it has {}; correct the name there or in "
                    "[can.mapping]",
                    what, message->name, database.file, place.substr(dot + 1), names_of(*message)));
  }
  if (signal->is_multiplexor) {
    return failure(
        fmt::format("{}: {} in {} is a multiplexor: it says what else is in the frame; name a signal that "
                    "has the value",
                    what, place, database.file));
  }
  if (!Field::fits(*signal)) {
    return failure(fmt::format(
        "{}: {} in {} has {} bits and begins within a byte; the station reads up to 57 there: name another "
        "signal",
        what, place, database.file, signal->bits));
  }
  return Place{message, signal};
}

template <std::size_t N>
Result<double> si_factor(const Database& database, std::string_view what, const std::string& place,
                         const std::string& unit, const Unit (&units)[N]) {
  std::string known;
  for (const Unit& candidate : units) {
    if (candidate.name == unit) return candidate.si;
    known += fmt::format("{}\"{}\"", known.empty() ? "" : ", ", candidate.name);
  }
  return failure(
      fmt::format("{}: {} in {} has the unit \"{}\"; expected {}: write one of them there, with the scale, "
                  "offset and range that go with it, or name another signal",
                  what, place, database.file, unit, known));
}

/// CAN FD by its size, or because Vector's attribute says so: 14 and 15 are its standard and extended FD
/// frames.
Result<FrameFormat> frame_format(const Database& database, const Message& message,
                                 const ProtocolMapping& mapping, const std::string& where) {
  std::string text;
  for (const auto* attributes : {&database.attribute_defaults, &message.attributes})
    if (const auto found = attributes->find("VFrameFormat"); found != attributes->end()) text = found->second;
  const bool declared = text == "14" || text == "15" || text.ends_with("_FD");
  if (message.size_bytes <= kClassicBytes && !declared) return FrameFormat::Classic;
  if (!is_fd_size(message.size_bytes))
    return failure(fmt::format("{} has {} bytes; a CAN FD frame has up to 8, 12, 16, 20, 24, 32, 48 or 64",
                               where, message.size_bytes));
  return mapping.fast_data ? FrameFormat::FdFastData : FrameFormat::Fd;
}

Result<FrameLayout> frame_layout(const Database& database, const Message& message,
                                 const ProtocolMapping& mapping) {
  const std::string where = fmt::format("message {} of {}", message.name, database.file);
  if (!message.defects.empty())
    return failure(fmt::format("{}: {} cannot be relied on: mend the file", message.defects.front(), where));
  const auto format = frame_format(database, message, mapping, where);
  if (!format) return failure(format.error().message);
  const auto counter = own_name(message, mapping.counter);
  if (!counter) return failure(fmt::format("{}: {}", where, counter.error().message));
  const auto crc = own_name(message, mapping.crc);
  if (!crc) return failure(fmt::format("{}: {}", where, crc.error().message));
  auto protection = FrameProtection::build(message, *counter, *crc, mapping.protection, where);
  if (!protection) return failure(protection.error().message);
  return FrameLayout{message.id, static_cast<std::uint8_t>(message.size_bytes), *format, *protection};
}

}  // namespace

Result<std::string> own_name(const Message& message, const std::vector<std::string>& names) {
  std::vector<std::string> own;
  for (const std::string& name : names) {
    const std::size_t dot = name.find('.');
    const bool is_for_this =
        dot == std::string::npos || std::string_view{name}.substr(0, dot) == message.name;
    std::string signal = dot == std::string::npos ? name : name.substr(dot + 1);
    if (is_for_this && message.find_signal(signal) != nullptr &&
        std::find(own.begin(), own.end(), signal) == own.end())
      own.push_back(std::move(signal));
  }
  if (own.size() > 1)
    return failure(fmt::format(
        "it has {} of the names in [can.mapping]: {}; write the one that is meant there as \"{}.{}\", and "
        "leave out the other names that it has",
        own.size(), fmt::join(own, ", "), message.name, own.front()));
  if (own.empty())
    return names.empty() ? std::string() : std::string(fmt::format("{}", fmt::join(names, " or ")));
  return own.front();
}

Frame FrameLayout::blank() const noexcept {
  Frame frame{id, size, {}, format};
  for (std::size_t i = 0; i < selector_count; ++i) selectors[i].field.set_raw(frame, selectors[i].value);
  return frame;
}

bool FrameLayout::is_meant_by(const Frame& frame) const noexcept {
  if (frame.id != id) return false;
  for (std::size_t i = 0; i < selector_count; ++i)
    if (frame.size != size || selectors[i].field.raw(frame) != selectors[i].value) return false;
  return true;
}

bool FrameLayout::intact(const Frame& frame) const noexcept {
  const bool classic = format == FrameFormat::Classic;
  return frame.size == size && (frame.format == FrameFormat::Classic) == classic && protection.matches(frame);
}

namespace {

/// The multiplexors that put all of `signals`, which are of one message, into its frames.
class MultiplexorChoice {
 public:
  explicit MultiplexorChoice(const Message& message) : message_(message) {}

  void need(const Signal& signal) {
    names_ += (names_.empty() ? "" : ", ") + signal.name;
    const Signal* selected = &signal;
    // A file may have multiplexors that go round in a circle: one of the defects for which a message is
    // refused.
    for (std::size_t i = 0; selected->multiplexor && i < message_.signals.size(); ++i) {
      wanted_[*selected->multiplexor].push_back(selected->selected_by);
      selected = &message_.signals[*selected->multiplexor];
    }
  }

  Result<void> choose(FrameLayout& layout, const std::string& file) const {
    const std::string where = fmt::format("message {} of {}", message_.name, file);
    if (wanted_.size() > kMaxSelectors)
      return failure(fmt::format("{}: {} are behind {} multiplexors; the station follows {}", where, names_,
                                 wanted_.size(), kMaxSelectors));
    for (const auto& [index, lists] : wanted_) {
      const Signal& multiplexor = message_.signals[index];
      const std::optional<std::uint64_t> value = common_value(lists);
      if (!value || !Field::fits(multiplexor))
        return failure(
            fmt::format("{}: no frame holds all of {}, as its multiplexor {} has it; name signals that "
                        "come together",
                        where, names_, multiplexor.name));
      layout.selectors[layout.selector_count++] = {Field(multiplexor, 1.0), *value};
    }
    return {};
  }

 private:
  using Ranges = std::vector<std::pair<std::uint64_t, std::uint64_t>>;

  /// The lowest value that lies in a range of each.
  static std::optional<std::uint64_t> common_value(const std::vector<Ranges>& lists) {
    std::optional<std::uint64_t> lowest;
    for (const Ranges& candidates : lists)
      for (const auto& candidate : candidates) {
        const std::uint64_t value = candidate.first;
        const bool common = std::all_of(lists.begin(), lists.end(), [value](const Ranges& ranges) {
          return std::any_of(ranges.begin(), ranges.end(), [value](const auto& range) {
            return range.first <= value && value <= range.second;
          });
        });
        if (common) lowest = std::min(value, lowest.value_or(value));
      }
    return lowest;
  }

  const Message& message_;
  std::string names_;
  std::map<std::size_t, std::vector<Ranges>> wanted_;  ///< by the multiplexor's index
};

/// Resolves the names of a mapping, one after the other, into a codec.
class CodecBuilder {
 public:
  CodecBuilder(const Database& database, const ProtocolMapping& mapping)
      : database_(database), mapping_(mapping) {
    codec_.period_ns = mapping.period_ns;
    codec_.samples_per_period = mapping.samples_per_period;
    codec_.commands_per_period = mapping.commands_per_period;
  }

  Result<ProtocolCodec> build() {
    const Result<void> outcome =
        check_names()
            .and_then([&] { return add_command(); })
            .and_then([&] { return check_setpoint(); })
            .and_then([&] { return add_feedback(); })
            .and_then([&] { return choose_multiplexors(); })
            .and_then([&] { return add_clock_tick(); })
            .and_then([&] { return add_sequence("start-up", mapping_.startup, codec_.startup); })
            .and_then([&] { return add_sequence("shut-down", mapping_.shutdown, codec_.shutdown); });
    if (!outcome) return failure(outcome.error().message);
    return codec_;
  }

 private:
  /// Whatever the file does not have, all of it at once.
  Result<void> check_names() const {
    std::vector<std::string> problems;
    for (const auto& [what, name] :
         {std::pair(is_told_velocity() ? "velocity command" : "torque command", &setpoint_name()),
          {"enable", &mapping_.enable},
          {"force", &mapping_.force},
          {"velocity", &mapping_.velocity},
          {"torque", &mapping_.torque},
          {"position", &mapping_.position},
          {"sample clock", &mapping_.sample_clock},
          {"enabled", &mapping_.enabled},
          {"watchdog", &mapping_.watchdog},
          {"fault", &mapping_.fault}}) {
      if (name->empty()) continue;
      if (const auto place = find(database_, what, *name); !place) problems.push_back(place.error().message);
    }
    for (const auto& [role, names] : {std::pair("counter", &mapping_.counter), {"crc", &mapping_.crc}})
      for (const std::string& name : *names)
        if (is_chosen_among_messages(name, names->size()) && !is_in_a_message(name))
          problems.push_back(
              fmt::format("{}: no message of {} has a signal {}; correct the name there or in [can.mapping]",
                          role, database_.file, name));
    if (problems.empty()) return {};
    return failure(fmt::format("{}", fmt::join(problems, "\n")));
  }

  static bool has_one_of(const Message& message, const std::vector<std::string>& names) {
    const auto own = own_name(message, names);
    return !own || message.find_signal(*own) != nullptr;
  }

  /// One name for all messages is looked for in each of them.
  static bool is_chosen_among_messages(const std::string& name, std::size_t names) {
    return names > 1 || name.find('.') != std::string::npos;
  }

  bool is_in_a_message(const std::string& name) const {
    return std::any_of(database_.messages.begin(), database_.messages.end(),
                       [&](const Message& message) { return has_one_of(message, {name}); });
  }

  template <class Units>
  Result<const Message*> command_field(std::string_view what, const std::string& name, const Units& units,
                                       Field& field) {
    const auto place = value_place(what, name);
    if (!place) return failure(place.error().message);
    const auto factor = si_factor(database_, what, name, place->signal->unit, units);
    if (!factor) return failure(factor.error().message);
    field = Field{*place->signal, *factor};
    choice(*place->message).need(*place->signal);
    return place->message;
  }

  MultiplexorChoice& choice(const Message& message) {
    return choices_.try_emplace(message.id, message).first->second;
  }

  Result<void> choose_multiplexors() {
    const auto choose = [&](FrameLayout& layout) {
      return choices_.at(layout.id).choose(layout, database_.file);
    };
    Result<void> outcome = choose(codec_.command);
    for (std::size_t i = 0; outcome && i < codec_.feedback_frames; ++i) outcome = choose(codec_.feedback[i]);
    return outcome;
  }

  /// Counter and checksum are written into each frame, whatever else may be mapped there.
  Result<Place> value_place(std::string_view what, const std::string& name) const {
    auto place = find(database_, what, name);
    if (!place) return place;
    for (const auto& [role, names] : {std::pair("counter", &mapping_.counter), {"crc", &mapping_.crc}})
      if (own_name(*place->message, *names) == place->signal->name)
        return failure(
            fmt::format("{}: {} in {} is what [can.mapping] names as {}; name a signal that has the value",
                        what, name, database_.file, role));
    return place;
  }

  bool is_told_velocity() const { return !mapping_.velocity_command.empty(); }
  const std::string& setpoint_name() const {
    return is_told_velocity() ? mapping_.velocity_command : mapping_.torque_command;
  }

  Result<const Message*> setpoint_field() {
    if (!is_told_velocity())
      return command_field("torque command", mapping_.torque_command, kTorqueUnits, codec_.setpoint);
    if (!mapping_.torque_command.empty())
      return failure(fmt::format(
          "[can.mapping] names both a torque command, {}, and a velocity command, {}, of {}, but a brake is "
          "told one of the two: leave the other one empty, torque_command = \"\" where it is told its speed",
          mapping_.torque_command, mapping_.velocity_command, database_.file));
    codec_.commanded = CommandedQuantity::Velocity;
    return command_field("velocity command", mapping_.velocity_command, kVelocityUnits, codec_.setpoint);
  }

  Result<void> add_command() {
    const auto setpoint = setpoint_field();
    if (!setpoint) return failure(setpoint.error().message);
    const auto enable = command_field("enable", mapping_.enable, kFlagUnits, codec_.enable);
    if (!enable) return failure(enable.error().message);
    if (*setpoint != *enable)
      return failure(
          fmt::format("enable: {} and {} must be signals of one message of {}, since a brake takes both at "
                      "once; name an enable flag of the command's message",
                      setpoint_name(), mapping_.enable, database_.file));
    const auto layout = frame_layout(database_, **setpoint, mapping_);
    if (!layout) return failure(layout.error().message);
    codec_.command = *layout;
    command_message_ = *setpoint;
    return {};
  }

  /// A brake closes and opens: zero and either sign of what moves it must fit.
  Result<void> check_signs(std::string_view what, std::string_view quantity, const std::string& name,
                           const Field& field) const {
    if (field.plausible(0.0) && field.minimum() < 0.0 && field.maximum() > 0.0) return {};
    return failure(fmt::format(
        "{}: {} in {} must have a range that includes a {} of either sign, since a brake closes and opens; "
        "it has {:g} to {:g} in SI units: correct its sign, scale, offset or range there, or name another "
        "signal",
        what, name, database_.file, quantity, field.minimum(), field.maximum()));
  }

  Result<void> check_setpoint() const {
    const Field& setpoint = codec_.setpoint;
    const std::string_view quantity = is_told_velocity() ? "velocity" : "torque";
    const std::string what = fmt::format("{} command", quantity);
    if (auto checked = check_signs(what, quantity, setpoint_name(), setpoint); !checked) return checked;
    Frame probe = codec_.command.blank();
    setpoint.encode(probe, 0.0);
    if (std::abs(setpoint.decode(probe)) > 0.01 * std::abs(setpoint.scale()))
      return failure(
          fmt::format("{}: {} in {} cannot express a {} of zero: its offset must be a multiple of its scale; "
                      "correct them there, or name another signal",
                      what, setpoint_name(), database_.file, quantity));
    return {};
  }

  template <class Units>
  Result<void> feedback_field(std::string_view what, const std::string& name, const Units& units,
                              bool required, FeedbackField& field) {
    if (name.empty() && !required) return {};
    const auto place = value_place(what, name);
    if (!place) return failure(place.error().message);
    if (place->message == command_message_)
      return failure(
          fmt::format("{}: {} in {} is in the command's own message, which the station sends; name a signal "
                      "of a message that the brake sends",
                      what, name, database_.file));
    const auto factor = si_factor(database_, what, name, place->signal->unit, units);
    if (!factor) return failure(factor.error().message);
    auto found = std::find(messages_.begin(), messages_.end(), place->message);
    if (found == messages_.end()) {
      if (messages_.size() == kMaxFeedbackFrames)
        return failure(fmt::format(
            "{}: with {} of {} the feedback is spread over more than {} messages; name signals that "
            "come together, or leave out a flag that the station can do without: \"\"",
            what, name, database_.file, kMaxFeedbackFrames));
      const auto layout = frame_layout(database_, *place->message, mapping_);
      if (!layout) return failure(layout.error().message);
      codec_.feedback[messages_.size()] = *layout;
      messages_.push_back(place->message);
      found = messages_.end() - 1;
    }
    field.present = true;
    field.frame = static_cast<std::size_t>(found - messages_.begin());
    field.field = Field{*place->signal, *factor};
    choice(*place->message).need(*place->signal);
    return {};
  }

  /// The order of the frames is that of the names here.
  Result<void> add_feedback() {
    const ProtocolMapping& m = mapping_;
    ProtocolCodec& c = codec_;
    const Result<void> outcome =
        feedback_field("force", m.force, kForceUnits, true, c.force)
            .and_then(
                [&] { return feedback_field("velocity", m.velocity, kVelocityUnits, true, c.velocity); })
            .and_then([&] { return feedback_field("torque", m.torque, kTorqueUnits, true, c.torque); })
            .and_then([&] { return feedback_field("position", m.position, kAngleUnits, false, c.position); })
            .and_then([&] {
              return feedback_field("sample clock", m.sample_clock, kTimeUnits, false, c.sample_clock);
            })
            .and_then([&] { return feedback_field("enabled", m.enabled, kFlagUnits, false, c.enabled); })
            .and_then([&] { return feedback_field("watchdog", m.watchdog, kFlagUnits, false, c.watchdog); })
            .and_then([&] { return feedback_field("fault", m.fault, kFlagUnits, false, c.fault); });
    codec_.feedback_frames = messages_.size();
    return outcome.and_then([&] { return check_signs("velocity", "velocity", m.velocity, c.velocity.field); })
        .and_then([&] { return check_signs("torque", "torque", m.torque, c.torque.field); });
  }

  Result<void> add_clock_tick() {
    if (!codec_.sample_clock.present) return {};
    const Signal& clock = *find(database_, "sample clock", mapping_.sample_clock)->signal;
    const double tick_ns = codec_.sample_clock.field.scale() * static_cast<double>(kNanosecondsPerSecond);
    const double span_ns = tick_ns * static_cast<double>(codec_.sample_clock.field.largest_raw());
    if (clock.type != ValueType::Unsigned || clock.offset != 0.0 || clock.bits > 62 || tick_ns < 1.0 ||
        std::abs(tick_ns - std::round(tick_ns)) > 1e-6 * tick_ns ||
        tick_ns > 0.1 * static_cast<double>(codec_.feedback_cycle_ns()) ||
        span_ns < 16.0 * static_cast<double>(codec_.period_ns))
      return failure(fmt::format(
          "sample clock: {} in {} must be an unsigned count of at most 62 bits without offset, its tick a "
          "whole number of nanoseconds up to {:g} ms, a tenth of the feedback's cycle, and wrap after {} ms "
          "at the earliest; sample_clock = \"\" if the brake sends no such clock",
          mapping_.sample_clock, database_.file, 1e-7 * static_cast<double>(codec_.feedback_cycle_ns()),
          16 * codec_.period_ns / kNanosecondsPerMillisecond));
    codec_.clock_tick_ns = std::llround(tick_ns);
    return {};
  }

  Result<void> add_sequence(std::string_view what, const std::vector<FrameRequest>& requests,
                            std::vector<SequenceStep>& steps) const {
    if (requests.size() > kMaxSequenceSteps)
      return failure(
          fmt::format("{}: {} frames are too many; at most {}", what, requests.size(), kMaxSequenceSteps));
    for (const FrameRequest& request : requests) {
      const std::string where = fmt::format("{} frame {}", what, steps.size() + 1);
      auto step = sequence_step(request, where);
      if (!step) return failure(step.error().message);
      step->counter = steps.size();
      for (std::size_t i = steps.size(); i-- > 0;)
        if (steps[i].frame.id == step->frame.id) step->counter = i;
      steps.push_back(*step);
    }
    return {};
  }

  Result<SequenceStep> sequence_step(const FrameRequest& request, const std::string& where) const {
    const Message* message = database_.find_message(request.message);
    if (message == nullptr)
      return failure(
          fmt::format("{}: there is no message {} in {}; correct the name there or in the "
                      "configuration",
                      where, request.message, database_.file));
    if (message == command_message_ ||
        std::find(messages_.begin(), messages_.end(), message) != messages_.end())
      return failure(fmt::format("{}: {} is sent in every period; it cannot be part of a sequence", where,
                                 request.message));
    // Such frames seldom have the counter and the checksum that the cyclic ones have.
    ProtocolMapping own = mapping_;
    if (!has_one_of(*message, own.counter)) own.counter.clear();
    if (!has_one_of(*message, own.crc)) {
      own.crc.clear();
      own.protection.checksum = Checksum::None;
    }
    const auto layout = frame_layout(database_, *message, own);
    if (!layout) return failure(fmt::format("{}: {}", where, layout.error().message));
    SequenceStep step{layout->blank(), layout->protection, std::llround(request.wait_ms * 1e6)};
    for (const auto& [name, value] : request.signals) {
      const Signal* signal = message->find_signal(name);
      if (signal == nullptr || own_name(*message, own.counter) == name ||
          own_name(*message, own.crc) == name || !Field::fits(*signal))
        return failure(fmt::format("{}: message {} of {} has no signal {} that can be set; it has {}", where,
                                   message->name, database_.file, name, names_of(*message)));
      const Field field(*signal, 1.0);
      field.encode(step.frame, value);
      if (!field.plausible(value) || std::abs(field.decode(step.frame) - value) > 0.51 * field.scale())
        return failure(fmt::format("{}: {}.{} cannot be {:g}: {} allows {:g} to {:g}", where, message->name,
                                   name, value, database_.file, field.minimum(), field.maximum()));
    }
    return step;
  }

  const Database& database_;
  const ProtocolMapping& mapping_;
  ProtocolCodec codec_;
  const Message* command_message_ = nullptr;
  std::vector<const Message*> messages_;                ///< of the feedback
  std::map<std::uint32_t, MultiplexorChoice> choices_;  ///< by the message's identifier
};

}  // namespace

Result<ProtocolCodec> ProtocolCodec::build(const Database& database, const ProtocolMapping& mapping) {
  return CodecBuilder(database, mapping).build();
}

std::vector<std::uint32_t> ProtocolCodec::feedback_ids() const {
  std::vector<std::uint32_t> ids;
  for (std::size_t i = 0; i < feedback_frames; ++i) ids.push_back(feedback[i].id);
  return ids;
}

std::vector<std::uint32_t> ProtocolCodec::command_ids() const {
  std::vector<std::uint32_t> ids{command.id};
  for (const auto* steps : {&startup, &shutdown})
    for (const SequenceStep& step : *steps)
      if (std::find(ids.begin(), ids.end(), step.frame.id) == ids.end()) ids.push_back(step.frame.id);
  return ids;
}

bool ProtocolCodec::needs_flexible_data_rate() const {
  bool fd = command.format != FrameFormat::Classic;
  for (const auto* steps : {&startup, &shutdown})
    for (const SequenceStep& step : *steps) fd = fd || step.frame.format != FrameFormat::Classic;
  for (std::size_t i = 0; i < feedback_frames; ++i) fd = fd || feedback[i].format != FrameFormat::Classic;
  return fd;
}

int ProtocolCodec::bits_per_period(double data_speedup) const {
  const auto bits_of = [&](const FrameLayout& frame) {
    return worst_case_bits(frame.id, frame.size, frame.format, data_speedup);
  };
  int bits = 0;
  for (std::size_t i = 0; i < feedback_frames; ++i) bits += bits_of(feedback[i]);
  return commands_per_period * bits_of(command) + samples_per_period * bits;
}

double bus_load(const ProtocolCodec& codec, double bitrate_bit_s, double data_speedup) {
  return codec.bits_per_period(data_speedup) / (1e-9 * static_cast<double>(codec.period_ns)) / bitrate_bit_s;
}

}  // namespace clampd::can
