#include "src/publish/password.hpp"

#include "clampd/record/file.hpp"

namespace clampd::publish {

Result<std::string> read_password(const std::string& file) {
  if (file.empty()) return std::string();
  return read_file(file).map(
      [](const std::string& text) { return text.substr(0, text.find_first_of("\r\n")); });
}

}  // namespace clampd::publish
