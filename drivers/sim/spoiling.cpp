#include "drivers/sim/spoiling.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace clampd::sim {
namespace {

constexpr std::array<double BrakeFeedback::*, 5> kMembers{
    &BrakeFeedback::force_N, &BrakeFeedback::velocity_rad_s, &BrakeFeedback::position_rad,
    &BrakeFeedback::torque_Nm, &BrakeFeedback::velocity_rad_s};

}  // namespace

std::string_view to_string(Reading reading) noexcept {
  switch (reading) {
    case Reading::Force:
      return "force";
    case Reading::Velocity:
      return "velocity";
    case Reading::Position:
      return "position";
    case Reading::Torque:
      return "torque";
    case Reading::Encoder:
      return "encoder";
  }
  return "?";
}

std::string_view to_string(Spoil spoil) noexcept {
  switch (spoil) {
    case Spoil::Frozen:
      return "frozen";
    case Spoil::Scaled:
      return "scaled";
    case Spoil::Negated:
      return "negated";
    case Spoil::Offset:
      return "offset";
    case Spoil::Late:
      return "late";
    case Spoil::Noisy:
      return "noisy";
    case Spoil::Silent:
      return "silent";
  }
  return "?";
}

bool SpoiledReading::valid() const noexcept {
  if (!when.valid() || !std::isfinite(amount)) return false;
  if (spoil == Spoil::Late) return amount >= 1.0 && amount <= static_cast<double>(kLatest);
  return spoil != Spoil::Noisy || amount >= 0.0;
}

Spoiler::Spoiler(std::vector<SpoiledReading> spoiled, std::uint64_t seed)
    : spoiled_(std::move(spoiled)), at_begin_(spoiled_.size()), begun_(spoiled_.size()), random_(seed) {}

double Spoiler::changed(const SpoiledReading& spoiled, double BrakeFeedback::*member,
                        const BrakeFeedback& before) noexcept {
  const double reading = history_[samples_ % history_.size()].*member;
  switch (spoiled.spoil) {
    case Spoil::Frozen:
      return before.*member;
    case Spoil::Scaled:
      return reading * spoiled.amount;
    case Spoil::Negated:
      return -reading;
    case Spoil::Offset:
      return reading + spoiled.amount;
    case Spoil::Late: {
      const std::size_t age = std::min(static_cast<std::size_t>(spoiled.amount), samples_);
      return history_[(samples_ - age) % history_.size()].*member;
    }
    case Spoil::Noisy:
      return reading + spoiled.amount * normal_(random_);
    case Spoil::Silent:
      return 0.0;
  }
  return reading;
}

void Spoiler::apply(BrakeFeedback& feedback, double time_s, double force_N) noexcept {
  if (spoiled_.empty()) return;
  history_[samples_ % history_.size()] = feedback;
  for (std::size_t i = 0; i < spoiled_.size(); ++i) {
    SpoiledReading& spoiled = spoiled_[i];
    spoiled.when.observe(time_s, force_N);
    if (!spoiled.when.active(time_s)) {
      begun_[i] = false;
      continue;
    }
    if (!begun_[i]) {
      at_begin_[i] = history_[(samples_ > 0 ? samples_ - 1 : 0) % history_.size()];
      begun_[i] = true;
    }
    const auto member = kMembers[static_cast<std::size_t>(spoiled.reading)];
    feedback.*member = changed(spoiled, member, at_begin_[i]);
    if (spoiled.reading == Reading::Encoder)
      feedback.position_rad = changed(spoiled, &BrakeFeedback::position_rad, at_begin_[i]);
  }
  ++samples_;
}

}  // namespace clampd::sim
