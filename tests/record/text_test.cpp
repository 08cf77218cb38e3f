#include "clampd/record/text.hpp"

#include <gtest/gtest.h>

namespace clampd {
namespace {

TEST(Utf8, IsToldFromWhatIsNone) {
  for (const char* text :
       {"", "SN-1", "M\xC3\xBCller", "\xE2\x82\xAC", "\xF0\x9F\x98\x80", "\xED\x9F\xBF", "\xF4\x8F\xBF\xBF"})
    EXPECT_TRUE(is_utf8(text)) << text;
  for (const char* bytes : {"\xFF", "M\xFCller", "\xC3", "\xC0\xAF", "\xE0\x80\xAF", "\xED\xA0\x80",
                            "\xF0\x80\x80\xAF", "\xF4\x90\x80\x80", "\xE2\x82", "\x80"})
    EXPECT_FALSE(is_utf8(bytes)) << bytes;
}

TEST(Utf8, MarksTakeThePlaceOfBytesThatAreNone) {
  EXPECT_EQ(with_replacement_marks("M\xC3\xBCller"), "M\xC3\xBCller");
  EXPECT_EQ(with_replacement_marks("M\xFCller"), "M\xEF\xBF\xBDller");
  EXPECT_EQ(with_replacement_marks("A\xE2\x82"), "A\xEF\xBF\xBD\xEF\xBF\xBD");
  EXPECT_TRUE(is_utf8(with_replacement_marks("\xFF\xC3\xA9\xED\xA0\x80")));
}

TEST(Trimmed, LosesWhiteSpaceAtBothEndsAsABrowserTrims) {
  EXPECT_EQ(trimmed("  X 1\t\r\n"), "X 1");
  EXPECT_EQ(trimmed("\xC2\xA0\xEF\xBB\xBFX\xE3\x80\x80"), "X");
  EXPECT_EQ(trimmed(" \xE2\x80\x89 "), "");
  EXPECT_EQ(trimmed("\xC3\xA0"), "\xC3\xA0") << "ends with a byte of the no-break space, and is none";
  EXPECT_EQ(trimmed(""), "");
}

}  // namespace
}  // namespace clampd
