#include "drivers/can/protocol.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <utility>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"

namespace clampd::can {
namespace {

/// Of changes of the torque: how fast they are forgotten, in rows; how many there must be, and how many times
/// more than at the row's beginning, before rows begin elsewhere.
constexpr double kForgetChange = 0.98, kLeastChange_Nm2 = 0.01, kClearChange = 4.0;

/// Samples that a jump counts for where counter and clock contradict each other, at most.
constexpr std::uint64_t kLargestJump = 16;

std::uint32_t next_count(std::uint32_t counter, std::uint64_t values) noexcept {
  return values == 0 ? 0 : static_cast<std::uint32_t>((counter + 1ULL) % values);
}

}  // namespace

AliveCheck::AliveCheck(std::uint64_t values, std::int64_t cycle_ns)
    : values_{values}, silence_ns_{static_cast<std::int64_t>(values / 2) * cycle_ns} {
  CLAMPD_ASSERT(values >= 4);
}

AliveVerdict AliveCheck::judge(std::uint32_t counter, std::int64_t arrival_ns) noexcept {
  const std::uint64_t ahead = counter_steps(last_, counter, values_);
  const bool silent = arrival_ns - last_arrival_ns_ > silence_ns_;
  const bool first = !started_ || silent;
  // Also a refused frame moves the reference: a brake that restarted is followed again from its second frame
  // on, and a frozen one, whose frames keep coming, never turns into a silence.
  started_ = true;
  last_ = counter;
  last_arrival_ns_ = arrival_ns;
  if (first || ahead == 1) return AliveVerdict::Next;
  if (ahead == 0) return AliveVerdict::Repeated;
  return ahead <= values_ / 2 ? AliveVerdict::Skipped : AliveVerdict::Backward;
}

StationProtocol::StationProtocol(const ProtocolCodec& codec)
    : codec_{codec},
      counter_values_{codec.feedback[0].protection.counter_values()},
      arrivals_{counter_values_, codec.feedback_cycle_ns()} {
  if (counter_values_ > 0) alive_.fill(AliveCheck(counter_values_, codec.feedback_cycle_ns()));
}

Frame StationProtocol::command(const DriveCommand& command) noexcept {
  const bool velocity = codec_.commanded == CommandedQuantity::Velocity;
  const double setpoint = velocity ? command.velocity_rad_s : command.torque_Nm;
  // A torque is never sent where the brake takes it for a speed.
  const bool enable = command.enable && command.commanded == codec_.commanded && std::isfinite(setpoint);
  Frame frame = codec_.command.blank();
  codec_.setpoint.encode(frame, enable ? setpoint : 0.0);
  codec_.enable.set_raw(frame, enable ? 1 : 0);
  const FrameProtection& protection = codec_.command.protection;
  protection.protect(frame, command_counter_);
  command_counter_ = next_count(command_counter_, protection.counter_values());
  return frame;
}

bool StationProtocol::plausible(std::size_t index, const Frame& frame) const noexcept {
  const auto judged = [&](const FeedbackField& part, bool is_measured) {
    if (!part.present || part.frame != index) return true;
    const double value = part.field.decode(frame);
    return part.field.plausible(value) && !(is_measured && part.field.saturated(value));
  };
  const auto good = [&](const FeedbackField& part) { return judged(part, false); };
  // A reading at the end of its range may be anything beyond: a tare of it is none, and a motion goes unseen.
  const auto measured = [&](const FeedbackField& part) { return judged(part, true); };
  return measured(codec_.force) && measured(codec_.velocity) && measured(codec_.torque) &&
         good(codec_.position) && good(codec_.enabled) && good(codec_.watchdog) && good(codec_.fault);
}

std::optional<BrakeFeedback> StationProtocol::accept(const Frame& frame, std::int64_t arrival_ns) noexcept {
  std::size_t index = 0;
  while (index < codec_.feedback_frames && !codec_.feedback[index].is_meant_by(frame)) ++index;
  if (index == codec_.feedback_frames) return std::nullopt;
  const FrameLayout& layout = codec_.feedback[index];
  if (!layout.intact(frame)) {
    ++counts_.crc_errors;
    return std::nullopt;
  }
  std::uint32_t counter = 0;
  if (counter_values_ > 0) {
    counter = layout.protection.counter_of(frame);
    const AliveVerdict verdict = alive_[index].judge(counter, arrival_ns);
    if (verdict == AliveVerdict::Repeated || verdict == AliveVerdict::Backward) {
      ++counts_.counter_errors;
      return std::nullopt;
    }
  }
  if (!plausible(index, frame)) {
    ++counts_.implausible;
    return std::nullopt;
  }
  // Without a counter, the frames of one sample are told by their arrival: one of each, close together.
  const bool same_sample = counter_values_ > 0
                               ? parts_counter_ == counter
                               : (received_parts_ & (1U << index)) == 0 &&
                                     arrival_ns - parts_arrival_ns_ <= codec_.feedback_cycle_ns() / 2;
  if (received_parts_ == 0 || !same_sample) {
    received_parts_ = 0;
    parts_counter_ = counter;
    parts_arrival_ns_ = arrival_ns;
  }
  parts_[index] = frame;
  received_parts_ |= 1U << index;
  if (received_parts_ != (1U << codec_.feedback_frames) - 1) return std::nullopt;
  received_parts_ = 0;
  return complete(arrival_ns);
}

/// Moves index and time on by the sample clock; false if the sample is refused.
bool StationProtocol::follow_sample_clock(std::uint32_t previous_counter) noexcept {
  const FeedbackField& clock_field = codec_.sample_clock;
  const std::uint64_t clock = clock_field.field.raw(parts_[clock_field.frame]);
  const std::uint64_t previous_clock = std::exchange(last_clock_, clock);
  if (!synchronised_) {
    synchronised_ = true;
    brake_time_ns_ = static_cast<std::int64_t>(clock) * codec_.clock_tick_ns;
    return true;
  }
  const auto elapsed_ticks =
      static_cast<std::int64_t>((clock - previous_clock) & clock_field.field.largest_raw());
  const std::int64_t elapsed_ns = elapsed_ticks * codec_.clock_tick_ns;
  const std::int64_t cycle_ns = codec_.feedback_cycle_ns();
  const std::int64_t samples = (elapsed_ns + cycle_ns / 2) / cycle_ns;
  const std::uint64_t counted = counter_steps(previous_counter, parts_counter_, counter_values_);
  // Clock and counter must tell the same story: the clock resolves whole turns of the counter, the counter
  // catches a clock that stands still or jumps.
  const bool consistent =
      samples >= 1 &&
      (counter_values_ == 0 || static_cast<std::uint64_t>(samples) % counter_values_ == counted) &&
      std::abs(elapsed_ns - samples * cycle_ns) <= cycle_ns / 5;
  if (!consistent) {
    // Index and time stay monotonic by what the counter says; the sample itself is refused.
    ++counts_.counter_errors;
    const bool told = counted > 0 && counted <= kLargestJump;
    const auto advance = static_cast<std::int64_t>(told ? counted : kLargestJump);
    sample_index_ += advance;
    brake_time_ns_ += advance * cycle_ns;
    counts_.lost_samples += static_cast<std::uint64_t>(advance);
    return false;
  }
  sample_index_ += samples;
  brake_time_ns_ += elapsed_ns;
  counts_.lost_samples += static_cast<std::uint64_t>(samples - 1);
  return true;
}

/// Moves index and time on by counter and arrival; false if no time of the sample is known.
bool StationProtocol::follow_arrivals(std::uint32_t previous_counter) noexcept {
  const std::uint64_t counted = counter_steps(previous_counter, parts_counter_, counter_values_);
  const ArrivalClock::Instant instant = arrivals_.follow(counted, parts_arrival_ns_);
  const bool good = instant.verdict == ArrivalClock::Verdict::Good;
  // Without a counter, what is refused is lost, like what lies in a gap: nothing says that the brake stands
  // still.
  const bool refused = instant.verdict == ArrivalClock::Verdict::Refused;
  counts_.counter_errors += refused && counter_values_ > 0 ? 1 : 0;
  if (!synchronised_) {
    synchronised_ = good;
  } else {
    sample_index_ += instant.samples;
    counts_.lost_samples += static_cast<std::uint64_t>(instant.samples - (good ? 1 : 0));
  }
  if (good) brake_time_ns_ = instant.time_ns;
  return good;
}

std::optional<BrakeFeedback> StationProtocol::complete(std::int64_t arrival_ns) noexcept {
  const auto value = [&](const FeedbackField& part) {
    return part.present ? part.field.decode(parts_[part.frame]) : 0.0;
  };
  const std::uint32_t previous_counter = std::exchange(last_counter_, parts_counter_);
  if (!(codec_.sample_clock.present ? follow_sample_clock(previous_counter)
                                    : follow_arrivals(previous_counter)))
    return std::nullopt;

  BrakeFeedback feedback;
  feedback.sample_index = sample_index_;
  feedback.brake_time_ns = brake_time_ns_;
  feedback.arrival_time_ns = arrival_ns;
  feedback.torque_Nm = value(codec_.torque);
  feedback.velocity_rad_s = value(codec_.velocity);
  feedback.force_N = value(codec_.force);
  feedback.position_rad = value(codec_.position);
  feedback.drive_enabled = !codec_.enabled.present || value(codec_.enabled) != 0.0;
  feedback.watchdog_tripped = value(codec_.watchdog) != 0.0;
  feedback.brake_fault = value(codec_.fault) != 0.0;
  return codec_.samples_per_period == 1 ? feedback : of_period(feedback);
}

/// Where in the row commands take effect: there the torque changes from one sample to the next.
void StationProtocol::follow_commands(const BrakeFeedback& sample) noexcept {
  const std::int64_t per_period = codec_.samples_per_period;
  const double change_Nm = sample.torque_Nm - last_torque_Nm_;
  const bool next = sample.sample_index == last_sample_ + 1;
  last_torque_Nm_ = sample.torque_Nm;
  last_sample_ = sample.sample_index;
  const auto place = static_cast<std::size_t>((sample.sample_index - shifted_) % per_period);
  if (next) changes_Nm2_[place] = kForgetChange * changes_Nm2_[place] + change_Nm * change_Nm;
  if (place != 0) return;
  const auto begin = changes_Nm2_.begin(), end = begin + per_period;
  const auto largest = std::max_element(begin, end);
  if (*largest < kLeastChange_Nm2 || *largest < kClearChange * *begin) return;
  shifted_ += largest - begin;
  std::rotate(begin, largest, end);
}

std::optional<BrakeFeedback> StationProtocol::of_period(const BrakeFeedback& sample) noexcept {
  follow_commands(sample);
  const std::int64_t index = sample.sample_index - shifted_;
  const std::int64_t place = index % codec_.samples_per_period, row = index / codec_.samples_per_period;
  if (place == 0) {
    period_ = sample;
    period_.sample_index = row;
    period_.brake_time_ns -= shifted_ * codec_.feedback_cycle_ns();
    samples_of_period_ = 1;
  } else if (place == samples_of_period_ && row == period_.sample_index) {
    ++samples_of_period_;
    period_.arrival_time_ns = sample.arrival_time_ns;
    period_.torque_Nm += sample.torque_Nm;
    period_.drive_enabled = sample.drive_enabled;
    period_.watchdog_tripped = period_.watchdog_tripped || sample.watchdog_tripped;
    period_.brake_fault = period_.brake_fault || sample.brake_fault;
  } else {
    samples_of_period_ = 0;
  }
  if (samples_of_period_ != codec_.samples_per_period) return std::nullopt;
  samples_of_period_ = 0;
  BrakeFeedback whole = period_;
  whole.torque_Nm /= codec_.samples_per_period;
  return whole;
}

BrakeProtocol::BrakeProtocol(const ProtocolCodec& codec) : codec_{codec} {
  const std::uint64_t values = codec.command.protection.counter_values();
  if (values > 0) alive_ = AliveCheck(values, codec.command_cycle_ns());
}

std::optional<DriveCommand> BrakeProtocol::accept(const Frame& frame, std::int64_t arrival_ns) noexcept {
  if (!codec_.command.is_meant_by(frame)) return std::nullopt;
  const FrameProtection& protection = codec_.command.protection;
  if (!codec_.command.intact(frame)) {
    ++counts_.crc_errors;
    return std::nullopt;
  }
  if (protection.has_counter()) {
    const AliveVerdict verdict = alive_.judge(protection.counter_of(frame), arrival_ns);
    if (verdict == AliveVerdict::Repeated || verdict == AliveVerdict::Backward) {
      ++counts_.counter_errors;
      return std::nullopt;
    }
  }
  DriveCommand command;
  command.commanded = codec_.commanded;
  const double setpoint = codec_.setpoint.decode(frame);
  (codec_.commanded == CommandedQuantity::Velocity ? command.velocity_rad_s : command.torque_Nm) = setpoint;
  command.enable = codec_.enable.raw(frame) != 0;
  if (!codec_.setpoint.plausible(setpoint)) {
    ++counts_.implausible;
    return std::nullopt;
  }
  return command;
}

std::size_t BrakeProtocol::feedback(const BrakeFeedback& reading, std::span<Frame> out,
                                    WireFault fault) noexcept {
  CLAMPD_ASSERT(out.size() >= codec_.feedback_frames);
  const FrameProtection& protection = codec_.feedback[0].protection;
  if (fault == WireFault::FrozenCounter && !protection.has_counter() && sent_[0].size > 0) {
    std::copy_n(sent_.begin(), codec_.feedback_frames, out.begin());
    return codec_.feedback_frames;
  }
  if (fault != WireFault::FrozenCounter)
    feedback_counter_ = next_count(feedback_counter_, protection.counter_values());
  if (fault == WireFault::Silent) return 0;
  for (std::size_t i = 0; i < codec_.feedback_frames; ++i) out[i] = codec_.feedback[i].blank();
  const auto put = [&](const FeedbackField& part, double value) {
    if (part.present) part.field.encode(out[part.frame], value);
  };
  put(codec_.force, reading.force_N);
  put(codec_.velocity, reading.velocity_rad_s);
  put(codec_.torque, reading.torque_Nm);
  put(codec_.position, reading.position_rad);
  put(codec_.enabled, reading.drive_enabled ? 1.0 : 0.0);
  put(codec_.watchdog, reading.watchdog_tripped ? 1.0 : 0.0);
  put(codec_.fault, reading.brake_fault ? 1.0 : 0.0);
  if (const FeedbackField& clock = codec_.sample_clock; clock.present)
    clock.field.set_raw(out[clock.frame],
                        static_cast<std::uint64_t>(reading.brake_time_ns / codec_.clock_tick_ns));
  if (fault == WireFault::ImpossibleValues) {
    // Every bit of the reading set: far beyond the range, under a valid CRC.
    codec_.force.field.set_raw(out[codec_.force.frame], codec_.force.field.largest_raw());
    codec_.velocity.field.set_raw(out[codec_.velocity.frame], codec_.velocity.field.largest_raw() / 2);
  }
  for (std::size_t i = 0; i < codec_.feedback_frames; ++i) {
    codec_.feedback[i].protection.protect(out[i], feedback_counter_);
    if (fault == WireFault::CorruptCrc) codec_.feedback[i].protection.spoil(out[i]);
  }
  std::copy_n(out.begin(), codec_.feedback_frames, sent_.begin());
  return codec_.feedback_frames;
}

}  // namespace clampd::can
