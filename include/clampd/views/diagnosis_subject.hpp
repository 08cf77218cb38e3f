#pragma once

#include <cstddef>
#include <string>

namespace clampd {

/// What was diagnosed: a brake, or a bare drive in the units of its model file.
struct DiagnosisSubject {
  std::size_t runs = 0;  ///< given to the diagnosis, held-out ones aside
  bool drive = false;    ///< no clamp force; judged by the torque that its motion needs
  std::string position_unit = "rad";
  std::string torque_unit = "N m";  ///< or "N" of a linear drive, "A" where the torque constant is not known

  std::string torque = "torque";  ///< what it is called: "force" of a linear drive

  /// What its reading is called.
  std::string effort() const { return torque_unit == "A" ? "current" : torque; }
};

}  // namespace clampd
