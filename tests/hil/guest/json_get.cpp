// json_get FILE POINTER: prints the value at a JSON pointer (RFC 6901), strings without quotes. Exit code 1
// if the file is no JSON or has no such value.

#include <nlohmann/json.hpp>

#include <fstream>
#include <iostream>

int main(int count, char** words) {
  if (count != 3) {
    std::cerr << "usage: json_get FILE POINTER\n";
    return 2;
  }
  try {
    std::ifstream file(words[1]);
    const nlohmann::json value = nlohmann::json::parse(file).at(nlohmann::json::json_pointer(words[2]));
    std::cout << (value.is_string() ? value.get<std::string>() : value.dump()) << '\n';
  } catch (const nlohmann::json::exception& error) {
    std::cerr << "json_get: " << words[1] << ": " << error.what() << '\n';
    return 1;
  }
  return 0;
}
