#include "drivers/can/protection.hpp"

#include <charconv>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <boost/crc.hpp>

namespace clampd::can {
namespace {

constexpr std::uint64_t kProfile1Values = 15;  // 15 itself is not used
constexpr std::size_t kProfile2Ids = 16;

using SaeJ1850 = boost::crc_optimal<8, 0x1D, 0xFF, 0xFF, false, false>;
using Profile1 = boost::crc_optimal<8, 0x1D, 0x00, 0x00, false, false>;
using Profile2 = boost::crc_optimal<8, 0x2F, 0xFF, 0xFF, false, false>;
using Profile4 = boost::crc_optimal<32, 0xF4ACFB13, 0xFFFFFFFF, 0xFFFFFFFF, true, true>;
using Profile5 = boost::crc_optimal<16, 0x1021, 0xFFFF, 0x0000, false, false>;
using Profile7 =
    boost::crc_optimal<64, 0x42F0E1EBA9EA3693, 0xFFFFFFFFFFFFFFFF, 0xFFFFFFFFFFFFFFFF, true, true>;

/// A frame's bytes in order without those of its checksum, between what comes before and after them.
struct Input {
  std::span<const std::uint8_t> before, head, tail, after;
};

template <class Crc>
std::uint64_t crc_of(Crc crc, const Input& input) noexcept {
  for (const auto part : {input.before, input.head, input.tail, input.after})
    crc.process_bytes(part.data(), part.size());
  return crc.checksum();
}

template <std::size_t bits>
std::uint64_t described_crc(const CrcDescription& d, const Input& input) noexcept {
  using Crc = boost::crc_basic<bits>;
  using Value = typename Crc::value_type;
  return crc_of(Crc(static_cast<Value>(d.polynomial), static_cast<Value>(d.start),
                    static_cast<Value>(d.final_xor), d.reflected, d.reflected),
                input);
}

std::uint64_t described_crc(const CrcDescription& d, const Input& input) noexcept {
  switch (d.width_bits) {
    case 8:
      return described_crc<8>(d, input);
    case 16:
      return described_crc<16>(d, input);
    case 32:
      return described_crc<32>(d, input);
    default:
      return described_crc<64>(d, input);
  }
}

std::uint64_t exclusive_or(const Input& input) noexcept {
  std::uint8_t result = 0;
  for (const auto part : {input.head, input.tail})
    for (const std::uint8_t byte : part) result ^= byte;
  return result;
}

/// A field of `bits` bits that begins at a whole byte, most significant byte first.
Field big_endian(std::size_t byte, std::size_t bits) {
  Signal signal;
  signal.start_bit = 8 * byte + 7;
  signal.bits = bits;
  signal.order = ByteOrder::Motorola;
  return Field{signal, 1.0};
}

/// What a checksum wants of the frame.
struct Layout {
  std::size_t checksum_bits = 8;
  std::optional<ByteOrder> order;           ///< of the checksum
  std::size_t counter_bits = 0;             ///< 0: any width that a frame can have
  std::optional<std::size_t> counter_byte;  ///< after the header's first one
  std::size_t header_bytes = 0;
  std::size_t checksum_at = 0;  ///< byte of the header
  std::uint64_t largest_data_id = 0xFFFF;
};

Layout layout_of(const ProtectionDescription& description) {
  constexpr auto kMotorola = ByteOrder::Motorola, kIntel = ByteOrder::Intel;
  switch (description.checksum) {
    case Checksum::E2e1a:
    case Checksum::E2e1b:
    case Checksum::E2e1c:
    case Checksum::E2e2:
      return {8, {}, 4, {}, 0, 0, 0xFFFF};
    case Checksum::E2e4:
      return {32, kMotorola, 16, 2, 12, 8, 0xFFFFFFFF};
    case Checksum::E2e5:
      return {16, kIntel, 8, 2, 3, 0, 0xFFFF};
    case Checksum::E2e7:
      return {64, kMotorola, 32, 12, 20, 0, 0xFFFFFFFF};
    case Checksum::Crc:
      return {static_cast<std::size_t>(description.crc.width_bits), {}, 0, {}, 0, 0, 0xFFFF};
    case Checksum::SaeJ1850:
    case Checksum::Xor:
    case Checksum::None:
      break;
  }
  return {};
}

bool is_plain_count(const Signal& signal) {
  return signal.type == ValueType::Unsigned && signal.scale == 1.0 && signal.offset == 0.0 &&
         !signal.multiplexor;
}

std::optional<std::uint64_t> number(std::string_view text) {
  std::uint64_t value = 0;
  const int base = text.starts_with("0x") || text.starts_with("0X") ? 16 : 10;
  if (base == 16) text.remove_prefix(2);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value, base);
  if (text.empty() || error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return value;
}

}  // namespace

/// Resolves one frame's protection.
class FrameProtection::Builder {
 public:
  Builder(const Message& message, const std::string& counter, const std::string& checksum,
          const ProtectionDescription& description, const std::string& where)
      : message_(message),
        counter_(counter),
        checksum_(checksum),
        description_(description),
        where_(where),
        layout_(layout_of(description)) {}

  Result<FrameProtection> build() {
    built_.checksum_ = description_.checksum;
    built_.crc_ = description_.crc;
    const Result<void> outcome = place_checksum()
                                     .and_then([&] { return place_counter(); })
                                     .and_then([&] { return read_data_id(); })
                                     .and_then([&] { return place_nibble(); });
    if (!outcome) return failure(outcome.error().message);
    if (built_.has_checksum()) {
      // Builds the CRC's table now rather than in the first tick.
      Frame blank{message_.id, static_cast<std::uint8_t>(message_.size_bytes), {}};
      built_.protect(blank, 0);
    }
    return built_;
  }

 private:
  std::string name() const {
    return std::string(kChecksumNames[static_cast<std::size_t>(description_.checksum)]);
  }

  /// What is in the way: a name that the message does not have, or a signal of another shape.
  std::string found(const Signal* signal, const std::string& wanted) const {
    if (signal == nullptr && wanted.empty()) return "; [can.mapping] names none";
    if (signal == nullptr)
      return fmt::format(
          "; it has no signal {}: name its own in [can.mapping], too, as a list of the names in all messages",
          wanted);
    return fmt::format("; there it is {} bits from bit {} on, scale {:g}, offset {:g}", signal->bits,
                       signal->start_bit, signal->scale, signal->offset);
  }

  Result<void> place_checksum() {
    if (description_.checksum == Checksum::None) return {};
    const Signal* signal = checksum_.empty() ? nullptr : message_.find_signal(checksum_);
    const bool shaped = signal != nullptr && signal->bits == layout_.checksum_bits &&
                        is_plain_count(*signal) &&
                        signal->start_bit % 8 == (signal->order == ByteOrder::Intel ? 0U : 7U) &&
                        (signal->bits == 8 || !layout_.order || *layout_.order == signal->order);
    if (!shaped)
      return failure(fmt::format(
          "{} needs a checksum {}: {} bits that fill whole bytes{}, unsigned, scale 1, offset 0, as "
          "[can.protection] checksum = \"{}\" has it; \"none\" if the brake's frames carry none{}",
          where_, checksum_, layout_.checksum_bits,
          !layout_.order                          ? ""
          : *layout_.order == ByteOrder::Motorola ? ", most significant byte first"
                                                  : ", least significant byte first",
          name(), found(signal, checksum_)));
    built_.value_ = Field{*signal, 1.0};
    built_.first_byte_ = signal->start_bit / 8;
    built_.bytes_ = signal->bits / 8;
    if (layout_.header_bytes == 0) return {};
    if (built_.first_byte_ < layout_.checksum_at ||
        built_.first_byte_ - layout_.checksum_at + layout_.header_bytes > message_.size_bytes)
      return failure(fmt::format("{}: the {} bytes of the header of \"{}\" do not fit around its checksum {}",
                                 where_, layout_.header_bytes, name(), checksum_));
    header_ = built_.first_byte_ - layout_.checksum_at;
    if (description_.checksum == Checksum::E2e4)
      place_header(big_endian(header_, 16), big_endian(header_ + 4, 32));
    if (description_.checksum == Checksum::E2e7)
      place_header(big_endian(header_ + 8, 32), big_endian(header_ + 16, 32));
    return {};
  }

  void place_header(const Field& length, const Field& data_id) {
    built_.has_header_ = true;
    built_.length_ = length;
    built_.data_id_field_ = data_id;
  }

  Result<void> place_counter() {
    const bool demanded = layout_.counter_bits > 0;
    if (counter_.empty() && !demanded) return {};
    const Signal* signal = counter_.empty() ? nullptr : message_.find_signal(counter_);
    constexpr std::size_t kLeastBits = 2, kMostBits = 32;
    const bool shaped = signal != nullptr && is_plain_count(*signal) && Field::fits(*signal) &&
                        (demanded ? signal->bits == layout_.counter_bits
                                  : signal->bits >= kLeastBits && signal->bits <= kMostBits);
    if (!shaped)
      return failure(fmt::format(
          "{} needs an alive counter {}: {} bits, unsigned, scale 1, offset 0{}{}", where_, counter_,
          demanded ? std::to_string(layout_.counter_bits) : fmt::format("{} to {}", kLeastBits, kMostBits),
          demanded ? fmt::format(", as [can.protection] checksum = \"{}\" has it", name())
                   : "; counter = \"\" in [can.mapping] if the brake's frames carry none",
          found(signal, counter_)));
    built_.counter_ = Field{*signal, 1.0};
    built_.counter_values_ = 1ULL << signal->bits;
    if (layout_.counter_byte) {
      const Field due = big_endian(header_ + *layout_.counter_byte, signal->bits);
      Frame probe;
      due.set_raw(probe, due.largest_raw() - 1);
      if (built_.counter_.raw(probe) != due.largest_raw() - 1)
        return failure(
            fmt::format("{}: \"{}\" has its counter at byte {}, most significant byte first; {} is elsewhere",
                        where_, name(), header_ + *layout_.counter_byte, counter_));
    }
    if (description_.checksum == Checksum::E2e1a || description_.checksum == Checksum::E2e1b ||
        description_.checksum == Checksum::E2e1c)
      built_.counter_values_ = kProfile1Values;
    return {};
  }

  const std::string* attribute(const std::string& key) const {
    const auto found = message_.attributes.find(key);
    return found == message_.attributes.end() ? nullptr : &found->second;
  }

  Result<void> read_data_id() {
    if (description_.checksum == Checksum::E2e2) return read_data_ids();
    built_.data_id_ = message_.id & 0xFFFFU;
    const std::string* text = attribute("E2EDataId");
    if (text == nullptr) return {};
    const auto id = number(*text);
    if (!id || *id > layout_.largest_data_id)
      return failure(fmt::format("{}: the attribute E2EDataId is '{}'; expected 0 to {}", where_, *text,
                                 layout_.largest_data_id));
    built_.data_id_ = static_cast<std::uint32_t>(*id);
    return {};
  }

  Result<void> read_data_ids() {
    const std::string* text = attribute("E2EDataIdList");
    std::vector<std::uint8_t> ids;
    if (text != nullptr) {
      std::string_view rest = *text;
      while (!rest.empty()) {
        const std::size_t comma = rest.find(',');
        std::string_view item = rest.substr(0, comma);
        while (item.starts_with(' ')) item.remove_prefix(1);
        while (item.ends_with(' ')) item.remove_suffix(1);
        const auto id = number(item);
        if (!id || *id > 0xFF) {
          ids.clear();
          break;
        }
        ids.push_back(static_cast<std::uint8_t>(*id));
        rest = comma == std::string_view::npos ? std::string_view{} : rest.substr(comma + 1);
      }
    }
    if (ids.size() != kProfile2Ids)
      return failure(
          fmt::format("{}: \"e2e-2\" takes another data id for each value of the counter: give the sixteen "
                      "of them, 0 to 255, "
                      "as its attribute E2EDataIdList, \"1,2,...\"; it is {}",
                      where_, text == nullptr ? "not there" : "'" + *text + "'"));
    std::copy(ids.begin(), ids.end(), built_.data_ids_.begin());
    return {};
  }

  /// The nibble stands beside the counter, in the other half of its byte (profile 1, variant C).
  Result<void> place_nibble() {
    if (description_.checksum != Checksum::E2e1c) return {};
    const Signal& counter = *message_.find_signal(counter_);
    const std::size_t lowest = counter.order == ByteOrder::Intel ? counter.start_bit : counter.start_bit - 3;
    if (lowest % 4 != 0)
      return failure(fmt::format(
          "{}: \"e2e-1c\" has counter and data id nibble in the halves of one byte; {} fills none", where_,
          counter_));
    Signal nibble;
    nibble.start_bit = lowest % 8 == 0 ? lowest + 4 : lowest - 4;
    nibble.bits = 4;
    built_.nibble_ = Field{nibble, 1.0};
    return {};
  }

  const Message& message_;
  const std::string& counter_;
  const std::string& checksum_;
  const ProtectionDescription& description_;
  const std::string& where_;
  const Layout layout_;
  FrameProtection built_;
  std::size_t header_ = 0;  ///< its first byte
};

Result<FrameProtection> FrameProtection::build(const Message& message, const std::string& counter,
                                               const std::string& checksum,
                                               const ProtectionDescription& description,
                                               const std::string& where) {
  return Builder(message, counter, checksum, description, where).build();
}

std::uint64_t FrameProtection::compute(const Frame& frame) const noexcept {
  const std::span<const std::uint8_t> bytes(frame.data.data(), frame.size);
  Input input;
  input.head = bytes.first(first_byte_);
  input.tail = bytes.subspan(first_byte_ + bytes_);
  const std::uint32_t counter = has_counter() ? counter_of(frame) : 0;
  const std::array<std::uint8_t, 2> id{static_cast<std::uint8_t>(data_id_ & 0xFFU),
                                       static_cast<std::uint8_t>((data_id_ >> 8U) & 0xFFU)};
  const std::span<const std::uint8_t> both(id);
  const std::array<std::uint8_t, 2> low{id[0], 0};
  switch (checksum_) {
    case Checksum::SaeJ1850:
      input.before = both;
      return crc_of(SaeJ1850(), input);
    case Checksum::E2e1a:
      input.before = both;
      return crc_of(Profile1(), input);
    case Checksum::E2e1b:
      input.before = both.subspan(counter % 2, 1);
      return crc_of(Profile1(), input);
    case Checksum::E2e1c:
      input.before = low;
      return crc_of(Profile1(), input);
    case Checksum::E2e2:
      input.after = std::span<const std::uint8_t>(data_ids_).subspan(counter % kProfile2Ids, 1);
      return crc_of(Profile2(), input);
    case Checksum::E2e4:
      return crc_of(Profile4(), input);
    case Checksum::E2e5:
      input.after = both;
      return crc_of(Profile5(), input);
    case Checksum::E2e7:
      return crc_of(Profile7(), input);
    case Checksum::Crc:
      if (crc_.data_id == DataIdPlace::Before) input.before = both;
      if (crc_.data_id == DataIdPlace::After) input.after = both;
      return described_crc(crc_, input);
    case Checksum::Xor:
      return exclusive_or(input);
    case Checksum::None:
      break;
  }
  return 0;
}

void FrameProtection::protect(Frame& frame, std::uint32_t alive_counter) const noexcept {
  if (has_counter()) counter_.set_raw(frame, alive_counter);
  if (checksum_ == Checksum::E2e1c) nibble_.set_raw(frame, data_id_ >> 8U);
  if (has_header_) {
    length_.set_raw(frame, frame.size);
    data_id_field_.set_raw(frame, data_id_);
  }
  if (has_checksum()) value_.set_raw(frame, compute(frame));
}

bool FrameProtection::header_matches(const Frame& frame) const noexcept {
  if (checksum_ == Checksum::E2e1c) return nibble_.raw(frame) == ((data_id_ >> 8U) & 0xFU);
  return !has_header_ || (length_.raw(frame) == frame.size && data_id_field_.raw(frame) == data_id_);
}

bool FrameProtection::matches(const Frame& frame) const noexcept {
  if (has_counter() && counter_of(frame) >= counter_values_) return false;
  return header_matches(frame) && (!has_checksum() || value_.raw(frame) == compute(frame));
}

void FrameProtection::spoil(Frame& frame) const noexcept {
  if (has_checksum()) value_.set_raw(frame, ~value_.raw(frame));
}

std::uint32_t FrameProtection::counter_of(const Frame& frame) const noexcept {
  return static_cast<std::uint32_t>(counter_.raw(frame));
}

}  // namespace clampd::can
