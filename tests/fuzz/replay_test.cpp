#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <gtest/gtest.h>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace clampd {
namespace {

/// The corpus of a target, and every input that once made it fail.
TEST(Fuzz, SurvivesItsCorpus) {
  const std::filesystem::path folder =
      std::filesystem::path(CLAMPD_SOURCE_DIR) / "tests/fuzz/corpus" / FUZZ_TARGET;
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  EXPECT_GE(files.size(), 5U) << "the corpus has gone from " << folder;
  EXPECT_LE(files.size(), 60U) << "keep it small: " << folder;
  LLVMFuzzerTestOneInput(nullptr, 0);
  for (const auto& file : files) {
    SCOPED_TRACE(file.string());
    std::ifstream stream(file, std::ios::binary);
    const std::string content{std::istreambuf_iterator<char>(stream), {}};
    EXPECT_LE(content.size(), 4096U) << "keep it small: " << file;
    LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(content.data()), content.size());
  }
}

}  // namespace
}  // namespace clampd
