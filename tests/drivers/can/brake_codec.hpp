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

}  // namespace clampd::can
