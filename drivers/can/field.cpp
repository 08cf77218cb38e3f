#include "drivers/can/field.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "clampd/base/assert.hpp"

namespace clampd::can {
namespace {

static_assert(std::endian::native == std::endian::little, "Field loads frames as little-endian words");

constexpr std::size_t kWordBytes = sizeof(std::uint64_t);

/// Bits from the top of the frame, its first byte's highest bit being 0, to the signal's highest bit
/// (Motorola) or from its bottom to the lowest one (Intel).
unsigned begin_of(const Signal& signal) {
  const auto start = static_cast<unsigned>(signal.start_bit);
  return signal.order == ByteOrder::Motorola ? 8 * (start / 8) + 7 - start % 8 : start;
}

std::size_t first_byte_of(const Signal& signal) {
  return std::min<std::size_t>(begin_of(signal) / 8, kMaxFrameBytes - kWordBytes);
}

}  // namespace

bool Field::fits(const Signal& signal) {
  return begin_of(signal) - 8 * first_byte_of(signal) + signal.bits <= 64;
}

Field::Field(const Signal& signal, double si_per_unit)
    : motorola_{signal.order == ByteOrder::Motorola},
      type_{signal.type},
      first_byte_{first_byte_of(signal)},
      bits_{static_cast<unsigned>(signal.bits)},
      mask_{signal.bits == 64 ? ~0ULL : (1ULL << signal.bits) - 1},
      scale_{signal.scale * si_per_unit},
      offset_{signal.offset * si_per_unit} {
  CLAMPD_ASSERT(fits(signal));
  const auto begin = static_cast<unsigned>(begin_of(signal) - 8 * first_byte_);
  shift_ = motorola_ ? 64 - begin - bits_ : begin;
  const auto [least, most] = limits_of_width();
  minimum_ = signal.has_range() ? signal.minimum * si_per_unit : least;
  maximum_ = signal.has_range() ? signal.maximum * si_per_unit : most;
  // A range that the width cannot reach at all stays as it is: then nothing is plausible.
  if (minimum_ <= most && maximum_ >= least) {
    minimum_ = std::max(minimum_, least);
    maximum_ = std::min(maximum_, most);
  }
}

std::pair<double, double> Field::limits_of_width() const {
  if (type_ == ValueType::Float32 || type_ == ValueType::Float64)
    return {-std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  const bool is_signed = type_ == ValueType::Signed;
  const double largest = static_cast<double>(is_signed ? mask_ >> 1U : mask_);
  const double one_end = (is_signed ? -largest - 1.0 : 0.0) * scale_ + offset_;
  return std::minmax(one_end, largest * scale_ + offset_);
}

std::uint64_t Field::load(const Frame& frame) const noexcept {
  std::uint64_t word = 0;
  std::memcpy(&word, frame.data.data() + first_byte_, sizeof word);
  return motorola_ ? __builtin_bswap64(word) : word;
}

void Field::store(Frame& frame, std::uint64_t word) const noexcept {
  if (motorola_) word = __builtin_bswap64(word);
  std::memcpy(frame.data.data() + first_byte_, &word, sizeof word);
}

std::uint64_t Field::raw(const Frame& frame) const noexcept {
  return (load(frame) >> shift_) & mask_;
}

void Field::set_raw(Frame& frame, std::uint64_t raw) const noexcept {
  store(frame, (load(frame) & ~(mask_ << shift_)) | ((raw & mask_) << shift_));
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

bool Field::saturated(double value) const noexcept {
  const double slack = 0.5 * step();
  return (value <= minimum_ + slack && std::abs(minimum_) > slack) ||
         (value >= maximum_ - slack && std::abs(maximum_) > slack);
}

}  // namespace clampd::can
