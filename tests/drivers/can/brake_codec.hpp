#pragma once

#include <gtest/gtest.h>

#include "drivers/can/codec.hpp"

namespace clampd::can {

/// The codec of the shipped DBC file.
inline ProtocolCodec brake_codec() {
  const auto codec = read_dbc(CLAMPD_SOURCE_DIR "/configs/brake.dbc").and_then([](const Database& database) {
    return ProtocolCodec::build(database, {});
  });
  EXPECT_TRUE(codec) << codec.error().message;
  return codec.value_or(ProtocolCodec{});
}

/// Of a brake with the messages Command and Feedback, which hold all that a check needs and no flags.
inline ProtocolMapping command_and_feedback_mapping() {
  ProtocolMapping names;
  names.torque_command = "Command.Torque";
  names.enable = "Command.Enable";
  names.force = "Feedback.Force";
  names.velocity = "Feedback.Velocity";
  names.torque = "Feedback.Torque";
  names.position = "Feedback.Position";
  names.sample_clock = "Feedback.Clock";
  names.enabled = names.watchdog = names.fault = "";
  names.counter = {"Counter"};
  return names;
}

}  // namespace clampd::can
