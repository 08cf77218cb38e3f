#include <algorithm>

#include <fmt/format.h>

#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

/// That is late, numbered as its choices are.
enum class Channel { Force = 1, Velocity, Torque };

class ChannelSkew final : public EquationsOf<ChannelSkew> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "channel-skew",
                                  .location = Location::Timing,
                                  .cause = "one channel is recorded samples later than the others",
                                  .excitation = "readings that change quickly",
                                  .parameters = {{.name = "fraction",
                                                  .unit = "samples",
                                                  .description = "of a sample, beside the whole ones",
                                                  .lower = 0,
                                                  .upper = 1,
                                                  .scale = 0.2},
                                                 {.name = "whole",
                                                  .unit = "samples",
                                                  .description = "late",
                                                  .role = Role::Refinement,
                                                  .lower = 0,
                                                  .upper = 10,
                                                  .scale = 1,
                                                  .starts = {0, 1, 2, 3, 4, 5, 6}},
                                                 {.name = "channel",
                                                  .unit = "",
                                                  .description = "that is late",
                                                  .role = Role::Choice,
                                                  .lower = 1,
                                                  .upper = 3,
                                                  .scale = 1,
                                                  .starts = {1, 2, 3},
                                                  .choices = {"clamp force", "velocity", "torque"}}},
                                  .states = 1};
    return kInfo;
  }
  /// The same delay in all, as far as another number of whole samples allows.
  std::vector<double> chosen_otherwise(std::vector<double> values, std::size_t parameter,
                                       double choice) const override {
    if (parameter == 1) values[0] = std::clamp(values[0] + values[1] - choice, 0.05, 0.95);
    values[parameter] = choice;
    return values;
  }
  EffectDelays delays(std::span<const double> values) const override {
    const int whole = static_cast<int>(values[1]);
    const Channel channel = effects_detail::chosen<Channel>(values[2]);
    EffectDelays late;
    (channel == Channel::Force ? late.force : channel == Channel::Velocity ? late.velocity : late.torque) = whole;
    return late;
  }
  std::string in_words(std::span<const double> values, std::span<const double>, double) const override {
    return fmt::format("the reading of {} comes {:.2g} samples late", choice_of(info().parameters[2], values[2]),
                       values[0] + values[1]);
  }
  /// A torque that is held from row to row and read late by a fraction of a row reads as a mixture of its
  /// last two values. The torque that acts is the mixture's inverse to second order: between this reading and
  /// the next, sharpened by what two such mixtures smooth.
  template <class T>
  void torque(effects_detail::TorqueInput<T>& input, const effects_detail::Own<T>& own, T*) const {
    if (effects_detail::chosen<Channel>(own.parameters[2]) != Channel::Torque) return;
    const T& late = own.parameters[0];
    const auto between = [&](const T& reading, const T& next) {
      return T(reading + late * (next - reading));
    };
    const T before = between(input.previous_torque_Nm, input.torque_Nm);
    const T now = between(input.torque_Nm, input.next_torque_Nm);
    const T after = between(input.next_torque_Nm, input.later_torque_Nm);
    input.torque_Nm = now - late * (1.0 - late) * (before - 2.0 * now + after);
  }
  /// The fraction, between the sample before and this one.
  template <class T>
  void read(effects_detail::Readout<T>& readout, const effects_detail::Own<T>& own) const {
    const Channel channel = effects_detail::chosen<Channel>(own.parameters[2]);
    if (channel == Channel::Force) readout.force_N += own.parameters[0] * (own.states[0] - readout.force_N);
    if (channel == Channel::Velocity)
      readout.velocity_rad_s += own.parameters[0] * (own.states[0] - readout.velocity_rad_s);
  }
  template <class T>
  void filter(const effects_detail::Transit<T>& transit, const effects_detail::Own<T>& own, T* states) const {
    // The chord's end for which read() meets the velocity's two straights or the force's parabola.
    if (effects_detail::chosen<Channel>(own.parameters[2]) == Channel::Velocity)
      states[0] = transit.reverses() ? beyond_reversal(transit, own.parameters[0])
                                     : transit.velocity_before_rad_s;
    else
      states[0] = transit.force_before_N - 0.5 * (1.0 - own.parameters[0]) * transit.force_bend_N;
  }
  template <class T>
  void settle(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own, T* states) const {
    states[0] = effects_detail::chosen<Channel>(own.parameters[2]) == Channel::Velocity ? instant.velocity : instant.force_N;
  }

 private:
  template <class T>
  static T beyond_reversal(const effects_detail::Transit<T>& transit, const T& fraction) {
    const T& after = transit.velocity_after_rad_s;
    const T before_reversal_s = fraction * transit.gap_s - transit.since_reversal_s;
    if (!(before_reversal_s > 0.0)) return after - after * transit.gap_s / transit.since_reversal_s;
    const T late = transit.velocity_before_rad_s * before_reversal_s / transit.until_reversal_s;
    return after + (late - after) / fraction;
  }
};

}  // namespace

const Effect& channel_skew() {
  static const ChannelSkew kEffect;
  return kEffect;
}

}  // namespace clampd
