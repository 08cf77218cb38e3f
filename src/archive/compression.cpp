#include "clampd/archive/compression.hpp"

#include <zlib.h>

#include <algorithm>
#include <array>

#include "clampd/base/assert.hpp"

namespace clampd {
namespace {

constexpr std::size_t kMaxText_bytes = 64U << 20U;

/// Nearly as small as the default level, in a third of its time: a check is saved while somebody waits.
constexpr int kLevel = 2;

}  // namespace

std::string compressed(std::string_view text) {
  uLongf size = compressBound(static_cast<uLong>(text.size()));
  std::string stream(size, '\0');
  const int done =
      compress2(reinterpret_cast<Bytef*>(stream.data()), &size, reinterpret_cast<const Bytef*>(text.data()),
                static_cast<uLong>(text.size()), kLevel);
  CLAMPD_ASSERT(done == Z_OK);
  stream.resize(size);
  return stream;
}

Result<std::string> decompressed(std::string_view stream) {
  z_stream state{};
  CLAMPD_ASSERT(inflateInit(&state) == Z_OK);
  state.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(stream.data()));
  state.avail_in = static_cast<uInt>(stream.size());
  std::string text;
  std::array<char, 65'536> part{};
  int status = Z_OK;
  while (status == Z_OK && text.size() <= kMaxText_bytes) {
    state.next_out = reinterpret_cast<Bytef*>(part.data());
    state.avail_out = static_cast<uInt>(part.size());
    status = inflate(&state, Z_NO_FLUSH);
    text.append(part.data(), part.size() - state.avail_out);
  }
  const bool whole = status == Z_STREAM_END && state.avail_in == 0;
  inflateEnd(&state);
  if (!whole) return failure("its compressed data are damaged");
  return text;
}

}  // namespace clampd
