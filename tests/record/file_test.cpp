#include "clampd/record/file.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <optional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

TEST(File, ReadsBackWhatItWrote) {
  const support::TemporaryDirectory directory;
  const std::string content("a\0b\r\n", 5);
  ASSERT_TRUE(write_file_atomically(directory.path("x"), content));
  const auto read = read_file(directory.path("x"));
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(*read, content);
  EXPECT_EQ(directory.entries(), 1u) << "the temporary file is gone";
}

TEST(File, ReplacesTheOldContentAndKeepsItsMode) {
  const support::TemporaryDirectory directory;
  const std::string path = directory.write("x", "a long old content");
  ASSERT_EQ(::chmod(path.c_str(), 0600), 0);
  ASSERT_TRUE(write_file_atomically(path, "new"));
  EXPECT_EQ(directory.read("x"), "new");
  struct stat status {};
  ASSERT_EQ(::stat(path.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 07777, 0600u);
}

TEST(File, KeepsALinkAndReplacesItsTarget) {
  const support::TemporaryDirectory directory;
  directory.write("target", "old");
  fs::create_symlink("target", directory.path("link"));
  ASSERT_TRUE(write_file_atomically(directory.path("link"), "new"));
  EXPECT_TRUE(fs::is_symlink(directory.path("link")));
  EXPECT_EQ(directory.read("target"), "new");
}

TEST(File, LeavesNothingWhereItCannotWrite) {
  const support::TemporaryDirectory directory;
  const auto missing = write_file_atomically(directory.path("no/such/x"), "content");
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().message, HasSubstr("no/such/x: cannot write: No such file or directory"));

  fs::create_directory(directory.path("folder"));
  const auto folder = write_file_atomically(directory.path("folder"), "content");
  ASSERT_FALSE(folder);
  EXPECT_THAT(folder.error().message, HasSubstr("is a directory"));
  EXPECT_EQ(directory.entries(), 1u);
  EXPECT_FALSE(write_file_atomically("", "content"));
}

TEST(File, WritesThroughADeviceInsteadOfReplacingIt) {
  ASSERT_TRUE(write_file_atomically("/dev/null", "content"));
  EXPECT_TRUE(fs::is_character_file("/dev/null"));
}

TEST(File, RefusesWhatIsNotARegularFile) {
  const support::TemporaryDirectory directory;
  ASSERT_EQ(::mkfifo(directory.path("pipe").c_str(), 0600), 0);
  const auto pipe = read_file(directory.path("pipe"));
  ASSERT_FALSE(pipe);
  EXPECT_THAT(pipe.error().message, HasSubstr("not a regular file"));
}

TEST(File, RefusesAHugeFileBeforeReadingIt) {
  const support::TemporaryDirectory directory;
  const std::string path = directory.write("huge", "");
  fs::resize_file(path, (std::uintmax_t{256} << 20) + 1);  // sparse: takes no room
  const auto huge = read_file(path);
  ASSERT_FALSE(huge);
  EXPECT_THAT(huge.error().message, HasSubstr("256 MiB"));
}

TEST(File, IsChangedByOneAtATime) {
  const support::TemporaryDirectory folder;
  const auto now = std::chrono::milliseconds(0);
  std::optional<FileLock> first;
  {
    Result<FileLock> taken = FileLock::take(folder.path("a"), now);
    ASSERT_TRUE(taken) << taken.error().message;
    first.emplace(std::move(*taken));
  }
  EXPECT_FALSE(FileLock::take(folder.path("a"), now));
  EXPECT_FALSE(FileLock::take(folder.path("b"), now)) << "files of one folder take turns";
  EXPECT_TRUE(FileLock::take(folder.path(""), now).error().message.find("another process") !=
              std::string::npos);
  first.reset();
  EXPECT_TRUE(FileLock::take(folder.path("a"), now));
  EXPECT_FALSE(FileLock::take(folder.path("none/a"), now));
}

}  // namespace
}  // namespace clampd
