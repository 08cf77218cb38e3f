#pragma once

#include <optional>
#include <span>
#include <string>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/views/diagnosis_subject.hpp"
#include "clampd/views/figure.hpp"

namespace clampd::pictures {

/// The unit in which the torques of these runs are easily read: 0.0005 N m is 0.5 mN m.
struct EffortScale {
  double factor = 1.0;
  std::string unit;
};
EffortScale effort_scale(double largest, const DiagnosisSubject& subject);

/// Measured and modelled torque of a run over time, and the difference. Nothing of a run of a single row.
std::optional<report::Figure> modelled_torque_picture(const RunView& view, bool extended,
                                                      const DiagnosisSubject& subject);

/// Torque over speed where the drive hardly accelerates, the rows of each direction in bins, measured and
/// modelled: the friction curve, with whatever load there is in it. Nothing where hardly a row is steady.
std::optional<report::Figure> friction_curve_picture(std::span<const RunView> views,
                                                     const DiagnosisSubject& subject);

}  // namespace clampd::pictures
