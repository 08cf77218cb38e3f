#pragma once

#include <string>
#include <string_view>

namespace clampd {

/// Whether all of it is well-formed UTF-8 (RFC 3629: no overlong forms, no surrogates, at most U+10FFFF).
bool is_utf8(std::string_view text) noexcept;

/// The text with U+FFFD in place of every byte that is part of no UTF-8 character.
std::string with_replacement_marks(std::string_view text);

/// Without white space at both ends: blanks, tabs, line ends, and the wider blanks of Unicode, as a browser
/// trims what is typed into a form.
std::string trimmed(std::string_view text);

}  // namespace clampd
