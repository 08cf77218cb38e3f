#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "drivers/can/codec.hpp"
#include "drivers/can/dbc.hpp"
#include "drivers/can/log.hpp"
#include "drivers/can/protocol.hpp"

namespace clampd::can {

/// Times between frames of one identifier.
struct Spacing {
  std::size_t count = 0;
  double median_ms = 0.0, least_ms = 0.0, most_ms = 0.0;
};

struct SignalFinding {
  std::string name;  ///< what it is to the station, e.g. "force"
  std::string unit;  ///< SI
  double least = std::numeric_limits<double>::infinity();
  double most = -std::numeric_limits<double>::infinity();
  std::size_t implausible = 0;  ///< outside of the DBC file's range
  std::size_t saturated = 0;    ///< at an end of it that is not zero
};

/// One frame of the mapping, as the log has it. Of the frames that are intact: counter and signals.
struct FrameFinding {
  std::string message;
  std::uint32_t id = 0;
  bool from_brake = false;
  std::size_t seen = 0;
  std::size_t wrong_size = 0, wrong_format = 0, wrong_checksum = 0;
  /// Of a multiplexed message: frames with its identifier that do not hold what the mapping names.
  std::size_t other_content = 0;
  std::map<std::size_t, std::size_t> sizes;  ///< of those with a wrong one: how many
  std::size_t counter_repeats = 0, counter_jumps = 0;
  std::optional<Spacing> spacing;  ///< nothing without time stamps or with one frame
  std::vector<SignalFinding> signals;
  /// Where most checksums are wrong: others of kChecksumNames that all of its frames agree with.
  std::vector<std::string> other_checksums;

  std::size_t good() const noexcept { return seen - wrong_size - wrong_format - wrong_checksum; }
};

/// A frame that the mapping does not name.
struct OtherFrame {
  std::size_t seen = 0;
  std::string message;  ///< of the DBC file; empty if it has none with this identifier
};

struct LogFinding {
  std::vector<FrameFinding> frames;  ///< the command first
  std::map<std::uint32_t, OtherFrame> others;
  std::size_t samples = 0;            ///< that the station would have taken
  ProtocolCounts counts;              ///< of the station's end
  double arrival_jitter_ms = 0.0;     ///< of the feedback, where the mapping has no sample clock
  double duration_s = 0.0;            ///< 0 without time stamps
  std::vector<std::string> problems;  ///< why a station could not work with this brake; each says what to do
  std::vector<std::string> notes;     ///< what the log does not tell, or what is unusual and does no harm
};

/// What a station with this mapping understands of a log. `database` is the one that `codec` and `mapping`
/// were made for.
LogFinding check_log(const FrameLog& log, const Database& database, const ProtocolMapping& mapping,
                     const ProtocolCodec& codec);

/// What the checks of a station ask of a quantity, in SI units.
struct Demand {
  double least = 0.0, most = 0.0;  ///< that their limits allow; equal where they do not limit it
  double mismatch = 0.0;           ///< by which readings may contradict each other
};

struct Demands {
  Demand torque, velocity, position, force;
};

/// Notes which signals have a range too narrow, or steps too coarse, in the DBC file for what checks ask.
void note_demands(const ProtocolCodec& codec, const Demands& demands, LogFinding& finding);

/// Which identifiers a log has, and which messages of the database they are; where no codec can be made.
std::map<std::uint32_t, OtherFrame> identifiers(const FrameLog& log, const Database& database);

}  // namespace clampd::can
