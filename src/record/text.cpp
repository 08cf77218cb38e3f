#include "clampd/record/text.hpp"

#include <algorithm>
#include <array>
#include <cstddef>

namespace clampd {
namespace {

constexpr std::string_view kReplacementMark = "\xEF\xBF\xBD";

bool continues(std::string_view text, std::size_t at) noexcept {
  return at < text.size() && (static_cast<unsigned char>(text[at]) & 0xc0U) == 0x80U;
}

/// Length of the character that the text begins with; 0 if it begins with none.
std::size_t character_length(std::string_view text) noexcept {
  const auto first = static_cast<unsigned char>(text[0]);
  if (first < 0x80) return 1;
  const auto second = static_cast<unsigned char>(text.size() > 1 ? text[1] : 0);
  if (first >= 0xc2 && first <= 0xdf) return continues(text, 1) ? 2 : 0;
  if (first >= 0xe0 && first <= 0xef) {
    const bool overlong = first == 0xe0 && second < 0xa0;
    const bool surrogate = first == 0xed && second >= 0xa0;
    return !overlong && !surrogate && continues(text, 1) && continues(text, 2) ? 3 : 0;
  }
  if (first >= 0xf0 && first <= 0xf4) {
    const bool overlong = first == 0xf0 && second < 0x90;
    const bool too_large = first == 0xf4 && second >= 0x90;
    const bool whole = continues(text, 1) && continues(text, 2) && continues(text, 3);
    return !overlong && !too_large && whole ? 4 : 0;
  }
  return 0;
}

/// What JavaScript's trim() takes off, in UTF-8.
constexpr std::array<std::string_view, 25> kWhiteSpace{
    " ",
    "\t",
    "\n",
    "\v",
    "\f",
    "\r",
    "\xC2\xA0",      // no-break space
    "\xE1\x9A\x80",  // ogham space
    "\xE2\x80\x80",  // U+2000 to U+200A
    "\xE2\x80\x81",
    "\xE2\x80\x82",
    "\xE2\x80\x83",
    "\xE2\x80\x84",
    "\xE2\x80\x85",
    "\xE2\x80\x86",
    "\xE2\x80\x87",
    "\xE2\x80\x88",
    "\xE2\x80\x89",
    "\xE2\x80\x8A",
    "\xE2\x80\xA8",  // line and paragraph separator
    "\xE2\x80\xA9",
    "\xE2\x80\xAF",
    "\xE2\x81\x9F",
    "\xE3\x80\x80",  // ideographic space
    "\xEF\xBB\xBF",  // byte order mark
};

}  // namespace

bool is_utf8(std::string_view text) noexcept {
  while (!text.empty()) {
    const std::size_t length = character_length(text);
    if (length == 0) return false;
    text.remove_prefix(length);
  }
  return true;
}

std::string with_replacement_marks(std::string_view text) {
  if (is_utf8(text)) return std::string(text);
  std::string marked;
  while (!text.empty()) {
    const std::size_t length = character_length(text);
    marked += length == 0 ? kReplacementMark : text.substr(0, length);
    text.remove_prefix(std::max<std::size_t>(length, 1));
  }
  return marked;
}

std::string trimmed(std::string_view text) {
  const auto begins = [&](std::string_view space) { return text.substr(0, space.size()) == space; };
  const auto ends = [&](std::string_view space) {
    return text.size() >= space.size() && text.substr(text.size() - space.size()) == space;
  };
  for (auto found = kWhiteSpace.begin(); found != kWhiteSpace.end();) {
    found = std::find_if(kWhiteSpace.begin(), kWhiteSpace.end(), begins);
    if (found != kWhiteSpace.end()) text.remove_prefix(found->size());
  }
  for (auto found = kWhiteSpace.begin(); found != kWhiteSpace.end();) {
    found = std::find_if(kWhiteSpace.begin(), kWhiteSpace.end(), ends);
    if (found != kWhiteSpace.end()) text.remove_suffix(found->size());
  }
  return std::string(text);
}

}  // namespace clampd
