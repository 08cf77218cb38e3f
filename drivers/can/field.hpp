#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "clampd/base/realtime.hpp"
#include "drivers/can/dbc.hpp"
#include "drivers/can/frame.hpp"

namespace clampd::can {

/// One signal of a frame, resolved to a shift and a mask over eight of the frame's bytes, in SI units.
class Field {
 public:
  Field() = default;
  /// `si_per_unit`: SI value of one of the signal's own units. The signal must fit (see fits()).
  Field(const Signal& signal, double si_per_unit);

  /// Whether the signal lies within some eight bytes beside each other. Only one of more than 57 bits that
  /// begins within a byte does not.
  static bool fits(const Signal& signal);

  CLAMPD_REALTIME std::uint64_t raw(const Frame& frame) const noexcept;
  CLAMPD_REALTIME void set_raw(Frame& frame, std::uint64_t raw) const noexcept;
  CLAMPD_REALTIME double decode(const Frame& frame) const noexcept;
  /// Rounds to the nearest raw value; saturates at the DBC's range and at the field's limits. NaN becomes the
  /// raw zero.
  CLAMPD_REALTIME void encode(Frame& frame, double value) const noexcept;
  /// Finite and within the DBC's range, where it states one.
  CLAMPD_REALTIME bool plausible(double value) const noexcept;
  /// Whether the value is the least or the most that the signal can tell, other than zero: what it tells of
  /// may be anything beyond.
  CLAMPD_REALTIME bool saturated(double value) const noexcept;
  std::uint64_t largest_raw() const noexcept { return mask_; }
  double scale() const noexcept { return scale_; }
  /// Between neighbouring values, in SI units; 0 of a float.
  double step() const noexcept {
    return type_ == ValueType::Float32 || type_ == ValueType::Float64 ? 0.0 : std::abs(scale_);
  }
  double minimum() const noexcept { return minimum_; }
  double maximum() const noexcept { return maximum_; }
  bool operator==(const Field&) const = default;

 private:
  /// Least and most that the type and the number of bits can hold, in SI units; infinite of a float.
  std::pair<double, double> limits_of_width() const;
  std::uint64_t load(const Frame& frame) const noexcept;
  void store(Frame& frame, std::uint64_t word) const noexcept;

  bool motorola_ = false;
  ValueType type_ = ValueType::Unsigned;
  std::size_t first_byte_ = 0;  ///< of the eight
  unsigned shift_ = 0;
  unsigned bits_ = 1;
  std::uint64_t mask_ = 1;
  double scale_ = 1.0;
  double offset_ = 0.0;
  double minimum_ = 0.0;  ///< SI; infinite where neither the DBC nor the field's width limits it
  double maximum_ = 0.0;
};

}  // namespace clampd::can
