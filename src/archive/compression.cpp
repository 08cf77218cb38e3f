#include "clampd/archive/compression.hpp"

#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <memory>
#include <optional>

#include "clampd/base/assert.hpp"

namespace clampd {
namespace {

constexpr std::size_t kMaxText_bytes = 64U << 20U;

/// Nearly as small as the default level, in a third of its time: a check is saved while somebody waits.
constexpr int kLevel = 2;

/// Higher levels take several times as long for a tenth of the size.
constexpr int kSmallerLevel = 9;

constexpr std::string_view kZstandardMagic = "\x28\xB5\x2F\xFD";

/// Nothing: it is damaged, or its text is too large.
std::optional<std::string> inflated(std::string_view stream) {
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
  if (!whole) return std::nullopt;
  return text;
}

/// The same of one Zstandard frame.
std::optional<std::string> unframed(std::string_view stream) {
  const std::unique_ptr<ZSTD_DCtx, decltype(&ZSTD_freeDCtx)> context(ZSTD_createDCtx(), &ZSTD_freeDCtx);
  CLAMPD_ASSERT(context != nullptr);
  ZSTD_inBuffer input{stream.data(), stream.size(), 0};
  std::string text;
  std::array<char, 65'536> part{};
  while (text.size() <= kMaxText_bytes) {
    ZSTD_outBuffer output{part.data(), part.size(), 0};
    const std::size_t before = input.pos, left = ZSTD_decompressStream(context.get(), &output, &input);
    text.append(part.data(), output.pos);
    if (ZSTD_isError(left) != 0) return std::nullopt;
    if (left == 0) return input.pos == input.size ? std::optional(std::move(text)) : std::nullopt;
    if (input.pos == before && output.pos == 0) return std::nullopt;  // it ends too early
  }
  return std::nullopt;
}

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

std::string compressed_smaller(std::string_view text) {
  std::string frame(ZSTD_compressBound(text.size()), '\0');
  const std::size_t size = ZSTD_compress(frame.data(), frame.size(), text.data(), text.size(), kSmallerLevel);
  CLAMPD_ASSERT(ZSTD_isError(size) == 0);
  frame.resize(size);
  return frame;
}

Result<std::string> decompressed(std::string_view stream) {
  const bool is_zstandard = stream.substr(0, kZstandardMagic.size()) == kZstandardMagic;
  std::optional<std::string> text = is_zstandard ? unframed(stream) : inflated(stream);
  if (!text) return failure("its compressed data are damaged");
  return std::move(*text);
}

}  // namespace clampd
