#pragma once

#include <cstdint>

#include "clampd/base/realtime.hpp"
#include "clampd/record/brake_port.hpp"
#include "clampd/record/reference.hpp"
#include "clampd/record/sample.hpp"

namespace clampd::rt {

/// What the sequence needs to know of the product's nominal brake, as plain numbers: this room knows no brake model.
struct NominalDrive {
  double inertia_kg_m2 = 2.91e-4;
  double ratio_m_rad = 2.63e-5;
  double coulomb_Nm = 7.67e-2;
  double static_Nm = 4.68e-2;
  double viscous_Nm_s_rad = 4.46e-4;
  double load_friction_Nm_N = 3.55e-5;
};

/// One check, planned before it starts and read-only for the loop while it runs.
struct CheckPlan {
  Reference reference;
  NominalDrive drive;
  std::uint16_t repeats = 20;
  double tare_s = 0.2;                   ///< rest in the clearance for the offsets
  double approach_velocity_rad_s = 20.0;
  double contact_force_N = 300.0;        ///< contact is found when the tared force passes this
  double clearance_rad = 6.0;            ///< how far to open from contact at the end, and for the tare
  double settle_s = 0.05;                ///< rest at the contact point before each run
  double phase_timeout_s = 5.0;          ///< any phase but the trajectory: then SequenceTimeout
  double torque_limit_Nm = 3.0;
};

/// What the loop shall do with this sample.
struct SequenceOutput {
  double torque_Nm = 0.0;  ///< command that acts from the next sample on; already within the plan's limit
  CheckPhase phase = CheckPhase::None;
  std::uint16_t repeat = 0;
  std::int32_t trajectory_index = -1;  ///< row of the run that *this* sample is; -1 outside of a run
  double force_reference_N = 0.0;      ///< reference at this sample
  FaultCause fault = FaultCause::None;
};

/// The whole check as a state machine over samples: open, tare, approach to contact, n times (settle, trajectory,
/// return), release. Pure: time is the brake's sample clock, no I/O, so that the bench and the tests run the same code.
class CheckSequence {
 public:
  /// `plan` must stay alive and unchanged until done() or abandon().
  CLAMPD_REALTIME void start(const CheckPlan* plan) noexcept;
  CLAMPD_REALTIME SequenceOutput step(const BrakeFeedback& feedback) noexcept;
  CLAMPD_REALTIME void abandon() noexcept;
  CLAMPD_REALTIME bool done() const noexcept;
};

}  // namespace clampd::rt
