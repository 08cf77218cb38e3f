#include "drivers/can/codec.hpp"

#include <fmt/core.h>

#include <algorithm>
#include <bit>
#include <boost/crc.hpp>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <utility>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"

namespace clampd::can {
namespace {

static_assert(std::endian::native == std::endian::little, "Field loads frames as little-endian words");

struct Unit {
  std::string_view name;
  double si;  ///< SI value of one
};

constexpr Unit kForceUnits[]{{"N", 1.0}, {"kN", 1e3}};
constexpr Unit kTorqueUnits[]{{"Nm", 1.0}, {"N m", 1.0}, {"N*m", 1.0}, {"mNm", 1e-3}};
constexpr Unit kVelocityUnits[]{{"rad/s", 1.0},
                                {"rpm", std::numbers::pi / 30.0},
                                {"1/min", std::numbers::pi / 30.0},
                                {"deg/s", std::numbers::pi / 180.0}};
constexpr Unit kAngleUnits[]{{"rad", 1.0}, {"mrad", 1e-3}, {"deg", std::numbers::pi / 180.0}};
constexpr Unit kTimeUnits[]{{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}};
constexpr Unit kFlagUnits[]{{"", 1.0}};

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
    return failure(fmt::format("{}: '{}' must read Message.Signal, e.g. BrakeFeedback.Force", what, place));
  }
  const Message* message = database.find_message(std::string_view{place}.substr(0, dot));
  if (message == nullptr) {
    return failure(fmt::format("{}: there is no message {} in {}; correct the name there or in the mapping",
                               what, place.substr(0, dot), database.file));
  }
  const Signal* signal = message->find_signal(std::string_view{place}.substr(dot + 1));
  if (signal == nullptr) {
    return failure(fmt::format("{}: message {} of {} has no signal {}; it has {}", what, message->name,
                               database.file, place.substr(dot + 1), names_of(*message)));
  }
  if (signal->multiplexor || signal->is_multiplexor) {
    return failure(fmt::format("{}: {} in {} is multiplexed; the loop needs it in every frame", what, place,
                               database.file));
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
      fmt::format("{}: {} in {} has the unit \"{}\"; expected {}", what, place, database.file, unit, known));
}

Result<FrameLayout> frame_layout(const Database& database, const Message& message,
                                 const ProtocolMapping& mapping) {
  const std::string where = fmt::format("message {} of {}", message.name, database.file);
  if (message.size_bytes > 8) {
    return failure(
        fmt::format("{} has {} bytes; a classic CAN frame has at most 8", where, message.size_bytes));
  }
  if (!message.defects.empty()) return failure(message.defects.front());
  FrameLayout layout;
  layout.id = message.id;
  layout.size = static_cast<std::uint8_t>(message.size_bytes);

  const Signal* counter = message.find_signal(mapping.counter);
  if (counter == nullptr || counter->bits != 4 || counter->type != ValueType::Unsigned ||
      counter->scale != 1.0 || counter->offset != 0.0 || counter->multiplexor) {
    return failure(fmt::format("{} needs an alive counter {}: 4 bits, unsigned, scale 1, offset 0", where,
                               mapping.counter));
  }
  layout.counter = Field{*counter, 1.0};

  const Signal* crc = message.find_signal(mapping.crc);
  const bool byte_aligned =
      crc != nullptr && crc->bits == 8 && crc->start_bit % 8 == (crc->order == ByteOrder::Intel ? 0U : 7U);
  if (!byte_aligned || crc->type != ValueType::Unsigned || crc->scale != 1.0 || crc->offset != 0.0 ||
      crc->multiplexor) {
    return failure(fmt::format("{} needs a CRC {}: 8 bits that fill one byte, unsigned, scale 1, offset 0",
                               where, mapping.crc));
  }
  layout.crc_byte = crc->start_bit / 8;

  layout.data_id = static_cast<std::uint16_t>(message.id & 0xFFFFU);
  if (const auto found = message.attributes.find("E2EDataId"); found != message.attributes.end()) {
    const std::string& text = found->second;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), layout.data_id);
    if (error != std::errc{} || end != text.data() + text.size()) {
      return failure(fmt::format("{}: the attribute E2EDataId is '{}'; expected 0 to 65535", where, text));
    }
  }
  return layout;
}

std::uint64_t little_endian_word(const Frame& frame) noexcept {
  std::uint64_t word = 0;
  std::memcpy(&word, frame.data.data(), sizeof word);
  return word;
}

}  // namespace

Field::Field(const Signal& signal, double si_per_unit)
    : motorola_{signal.order == ByteOrder::Motorola},
      type_{signal.type},
      bits_{static_cast<unsigned>(signal.bits)},
      mask_{signal.bits == 64 ? ~0ULL : (1ULL << signal.bits) - 1},
      scale_{signal.scale * si_per_unit},
      offset_{signal.offset * si_per_unit} {
  const auto start = static_cast<unsigned>(signal.start_bit);
  // In the byte-swapped word the signal's highest bit sits start/8 bytes and 7 - start%8 bits from the top.
  const unsigned from_top = 8 * (start / 8) + 7 - start % 8;
  CLAMPD_ASSERT((motorola_ ? from_top : start) + bits_ <= 64);
  shift_ = motorola_ ? 64 - from_top - bits_ : start;
  if (signal.has_range()) {
    minimum_ = signal.minimum * si_per_unit;
    maximum_ = signal.maximum * si_per_unit;
  } else {
    minimum_ = -std::numeric_limits<double>::infinity();
    maximum_ = std::numeric_limits<double>::infinity();
  }
}

std::uint64_t Field::raw(const Frame& frame) const noexcept {
  const std::uint64_t word = little_endian_word(frame);
  return ((motorola_ ? __builtin_bswap64(word) : word) >> shift_) & mask_;
}

void Field::set_raw(Frame& frame, std::uint64_t raw) const noexcept {
  std::uint64_t word = little_endian_word(frame);
  if (motorola_) word = __builtin_bswap64(word);
  word = (word & ~(mask_ << shift_)) | ((raw & mask_) << shift_);
  if (motorola_) word = __builtin_bswap64(word);
  std::memcpy(frame.data.data(), &word, sizeof word);
}

double Field::decode(const Frame& frame) const noexcept {
  const std::uint64_t bits = raw(frame);
  double value = 0.0;
  switch (type_) {
    case ValueType::Unsigned:
      value = static_cast<double>(bits);
      break;
    case ValueType::Signed:
      value = static_cast<double>(static_cast<std::int64_t>(bits << (64 - bits_)) >> (64 - bits_));
      break;
    case ValueType::Float32:
      value = std::bit_cast<float>(static_cast<std::uint32_t>(bits));
      break;
    case ValueType::Float64:
      value = std::bit_cast<double>(bits);
      break;
  }
  return value * scale_ + offset_;
}

void Field::encode(Frame& frame, double value) const noexcept {
  if (std::isnan(value)) {
    set_raw(frame, 0);
    return;
  }
  const double scaled = (std::clamp(value, minimum_, maximum_) - offset_) / scale_;
  switch (type_) {
    case ValueType::Unsigned: {
      // 2^64 is not a uint64: saturate in floating point before the conversion.
      const double rounded = std::round(scaled);
      set_raw(frame, rounded <= 0.0                          ? 0
                     : rounded >= static_cast<double>(mask_) ? mask_
                                                             : static_cast<std::uint64_t>(rounded));
      return;
    }
    case ValueType::Signed: {
      const double largest = static_cast<double>(mask_ >> 1U);
      const double rounded = std::round(scaled);
      const std::uint64_t top = mask_ >> 1U;
      set_raw(frame, rounded >= largest ? top
                     : rounded <= -largest - 1.0
                         ? ~top
                         : static_cast<std::uint64_t>(static_cast<std::int64_t>(rounded)));
      return;
    }
    case ValueType::Float32:
      set_raw(frame, std::bit_cast<std::uint32_t>(static_cast<float>(scaled)));
      return;
    case ValueType::Float64:
      set_raw(frame, std::bit_cast<std::uint64_t>(scaled));
      return;
  }
}

bool Field::plausible(double value) const noexcept {
  // Half a step of room: the ends of the range are raw values, and scaling them rounds.
  const double slack = 0.5 * std::abs(scale_);
  return std::isfinite(value) && value >= minimum_ - slack && value <= maximum_ + slack;
}

std::uint8_t e2e_crc(std::uint16_t data_id, const Frame& frame, std::size_t crc_byte) noexcept {
  boost::crc_optimal<8, 0x1D, 0xFF, 0xFF, false, false> crc;
  crc.process_byte(static_cast<unsigned char>(data_id & 0xFFU));
  crc.process_byte(static_cast<unsigned char>(data_id >> 8U));
  for (std::size_t i = 0; i < frame.size; ++i) {
    if (i != crc_byte) crc.process_byte(frame.data[i]);
  }
  return static_cast<std::uint8_t>(crc.checksum());
}

Frame FrameLayout::blank() const noexcept {
  return Frame{id, size, {}};
}

void FrameLayout::protect(Frame& frame, std::uint8_t alive_counter) const noexcept {
  counter.set_raw(frame, alive_counter);
  frame.data[crc_byte] = e2e_crc(data_id, frame, crc_byte);
}

bool FrameLayout::crc_matches(const Frame& frame) const noexcept {
  return frame.size == size && frame.data[crc_byte] == e2e_crc(data_id, frame, crc_byte);
}

std::uint8_t FrameLayout::counter_of(const Frame& frame) const noexcept {
  return static_cast<std::uint8_t>(counter.raw(frame));
}

namespace {

/// Resolves the names of a mapping, one after the other, into a codec.
class CodecBuilder {
 public:
  CodecBuilder(const Database& database, const ProtocolMapping& mapping)
      : database_(database), mapping_(mapping) {}

  Result<ProtocolCodec> build() {
    const Result<void> outcome = add_command()
                                     .and_then([&] { return check_torque_command(); })
                                     .and_then([&] { return add_feedback(); })
                                     .and_then([&] { return add_clock_tick(); });
    if (!outcome) return failure(outcome.error().message);
    // Builds the CRC's table now rather than in the first tick.
    Frame warm_up = codec_.command.blank();
    codec_.command.protect(warm_up, 0);
    return codec_;
  }

 private:
  template <class Units>
  Result<const Message*> command_field(std::string_view what, const std::string& name, const Units& units,
                                       Field& field) const {
    const auto place = find(database_, what, name);
    if (!place) return failure(place.error().message);
    const auto factor = si_factor(database_, what, name, place->signal->unit, units);
    if (!factor) return failure(factor.error().message);
    if (place->message->size_bytes <= 8) field = Field{*place->signal, *factor};
    return place->message;
  }

  Result<void> add_command() {
    const auto torque =
        command_field("torque command", mapping_.torque_command, kTorqueUnits, codec_.torque_command);
    if (!torque) return failure(torque.error().message);
    const auto enable = command_field("enable", mapping_.enable, kFlagUnits, codec_.enable);
    if (!enable) return failure(enable.error().message);
    if (*torque != *enable)
      return failure(fmt::format("{} and {} must be signals of one message of {}", mapping_.torque_command,
                                 mapping_.enable, database_.file));
    const auto layout = frame_layout(database_, **torque, mapping_);
    if (!layout) return failure(layout.error().message);
    codec_.command = *layout;
    command_message_ = *torque;
    return {};
  }

  Result<void> check_torque_command() const {
    const Field& torque = codec_.torque_command;
    if (!torque.plausible(0.0) || !(torque.minimum() < 0.0) || !(torque.maximum() > 0.0))
      return failure(fmt::format("{} in {} must have a range that includes torques of both signs",
                                 mapping_.torque_command, database_.file));
    Frame probe = codec_.command.blank();
    torque.encode(probe, 0.0);
    if (std::abs(torque.decode(probe)) > 0.01 * std::abs(torque.scale()))
      return failure(
          fmt::format("{} in {} cannot express zero torque: its offset must be a multiple of its scale",
                      mapping_.torque_command, database_.file));
    return {};
  }

  template <class Units>
  Result<void> feedback_field(std::string_view what, const std::string& name, const Units& units,
                              bool required, FeedbackField& field) {
    if (name.empty() && !required) return {};
    const auto place = find(database_, what, name);
    if (!place) return failure(place.error().message);
    if (place->message == command_message_)
      return failure(fmt::format("{}: {} is in the command's own message", what, name));
    const auto factor = si_factor(database_, what, name, place->signal->unit, units);
    if (!factor) return failure(factor.error().message);
    auto found = std::find(messages_.begin(), messages_.end(), place->message);
    if (found == messages_.end()) {
      if (messages_.size() == kMaxFeedbackFrames)
        return failure(fmt::format("the feedback is spread over more than {} messages", kMaxFeedbackFrames));
      const auto layout = frame_layout(database_, *place->message, mapping_);
      if (!layout) return failure(layout.error().message);
      codec_.feedback[messages_.size()] = *layout;
      messages_.push_back(place->message);
      found = messages_.end() - 1;
    }
    field.present = true;
    field.frame = static_cast<std::size_t>(found - messages_.begin());
    field.field = Field{*place->signal, *factor};
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
              return feedback_field("sample clock", m.sample_clock, kTimeUnits, true, c.sample_clock);
            })
            .and_then([&] { return feedback_field("enabled", m.enabled, kFlagUnits, false, c.enabled); })
            .and_then([&] { return feedback_field("watchdog", m.watchdog, kFlagUnits, false, c.watchdog); })
            .and_then([&] { return feedback_field("fault", m.fault, kFlagUnits, false, c.fault); });
    codec_.feedback_frames = messages_.size();
    return outcome;
  }

  Result<void> add_clock_tick() {
    const Signal& clock = *find(database_, "sample clock", mapping_.sample_clock)->signal;
    const double tick_ns = codec_.sample_clock.field.scale() * static_cast<double>(kNanosecondsPerSecond);
    const double span_ns = tick_ns * static_cast<double>(codec_.sample_clock.field.largest_raw());
    if (clock.type != ValueType::Unsigned || clock.offset != 0.0 || clock.bits > 62 || tick_ns < 1.0 ||
        std::abs(tick_ns - std::round(tick_ns)) > 1e-6 * tick_ns ||
        tick_ns > 0.1 * static_cast<double>(kPeriod_ns) || span_ns < 16.0 * static_cast<double>(kPeriod_ns))
      return failure(fmt::format(
          "{} in {} must be an unsigned count of at most 62 bits without offset, its tick a whole "
          "number of nanoseconds up to 0.1 ms, and wrap after 16 ms at the earliest",
          mapping_.sample_clock, database_.file));
    codec_.clock_tick_ns = std::llround(tick_ns);
    return {};
  }

  const Database& database_;
  const ProtocolMapping& mapping_;
  ProtocolCodec codec_;
  const Message* command_message_ = nullptr;
  std::vector<const Message*> messages_;  ///< of the feedback
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

int ProtocolCodec::bits_per_period() const {
  int bits = worst_case_bits(command.id, command.size);
  for (std::size_t i = 0; i < feedback_frames; ++i) bits += worst_case_bits(feedback[i].id, feedback[i].size);
  return bits;
}

double bus_load(const ProtocolCodec& codec, double bitrate_bit_s) {
  return codec.bits_per_period() / kPeriod_s / bitrate_bit_s;
}

}  // namespace clampd::can
