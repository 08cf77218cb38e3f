#pragma once

#include <string>
#include <string_view>

#include "clampd/base/result.hpp"
#include "clampd/record/check_record.hpp"
#include "drivers/can/codec.hpp"

namespace clampd {

/// The raw runs of a check as a log that `candump -l` might have written, for canplayer, log2asc and the
/// like. It is a reconstruction: records keep samples, not frames. Each row becomes the feedback frames of
/// its instant and, half a period earlier, the command frame for the torque that acts from there; force and
/// velocity are without the sensors' offsets, which the tare took away; where the brake samples more often
/// than there are rows, each sample of a row has the row's readings; repeats follow one another after pauses
/// of about 0.1 s. Counters, clocks and CRCs are as the codec makes them. Errors: no runs, or their rows were
/// removed by retention.
Result<std::string> format_candump(const CheckRecord& record, const can::ProtocolCodec& codec,
                                   std::string_view interface);

}  // namespace clampd
