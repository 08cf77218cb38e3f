#include "dashboard/browser.hpp"

#include <unistd.h>

#include <fstream>
#include <stdexcept>
#include <vector>

#include <openssl/evp.h>

#include "clampd/http/client.hpp"
#include "support/eventually.hpp"
#include "support/network.hpp"

namespace clampd::screen {

namespace {

constexpr const char* kDriver = "/usr/bin/chromedriver";
constexpr const char* kChromium = "/usr/bin/chromium";

}  // namespace

bool Browser::is_installed() {
  return access(kDriver, X_OK) == 0 && access(kChromium, X_OK) == 0;
}

Browser::Browser(int width, int height)
    : port_(support::free_port()),
      driver_({kDriver, "--port=" + std::to_string(port_)}, folder_.path("driver.log"),
              {"HOME=" + folder_.path("")}) {
  if (!support::eventually([&] {
        return http::exchange("127.0.0.1", port_, {"GET", "/status"}).has_value();
      }))
    throw std::runtime_error("chromedriver does not answer");
  const std::string size = "--window-size=" + std::to_string(width) + "," + std::to_string(height);
  const nlohmann::json options{
      {"binary", kChromium},
      {"args",
       {"--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars",
        "--disable-background-networking", "--user-data-dir=" + folder_.path("profile"), size}}};
  const nlohmann::json session = ask("POST", "/session",
                                     {{"capabilities",
                                       {{"alwaysMatch",
                                         {{"browserName", "chrome"},
                                          {"goog:chromeOptions", options},
                                          {"goog:loggingPrefs", {{"browser", "ALL"}}}}}}}});
  session_ = "/session/" + session.at("sessionId").get<std::string>();
  resize(width, height);
}

/// The window is larger than the page; the pictures shall be as wide as asked for.
void Browser::resize(int width, int height) {
  ask("POST", session_ + "/goog/cdp/execute",
      {{"cmd", "Emulation.setDeviceMetricsOverride"},
       {"params", {{"width", width}, {"height", height}, {"deviceScaleFactor", 1}, {"mobile", false}}}});
}

void Browser::delay_network(int latency_ms) {
  ask("POST", session_ + "/goog/cdp/execute",
      {{"cmd", "Network.enable"}, {"params", nlohmann::json::object()}});
  ask("POST", session_ + "/goog/cdp/execute",
      {{"cmd", "Network.emulateNetworkConditions"},
       {"params",
        {{"offline", false},
         {"latency", latency_ms},
         {"downloadThroughput", -1},
         {"uploadThroughput", -1}}}});
}

Browser::~Browser() {
  if (!session_.empty()) http::exchange("127.0.0.1", port_, {"DELETE", session_});
}

nlohmann::json Browser::ask(const std::string& method, const std::string& path, const nlohmann::json& body) {
  http::Call call{method, path};
  if (method != "GET") call.body = body.is_null() ? "{}" : body.dump();
  call.answer_within = std::chrono::seconds(120);
  const auto answer = http::exchange("127.0.0.1", port_, call);
  if (!answer) throw std::runtime_error("chromedriver: no answer to " + path + ": " + answer.error().message);
  nlohmann::json document = nlohmann::json::parse(answer->body);
  if (answer->status != 200)
    throw std::runtime_error("chromedriver: " + document.at("value").value("message", answer->body));
  return document.at("value");
}

void Browser::open(const std::string& address) {
  ask("POST", session_ + "/url", {{"url", address}});
}

void Browser::type(const std::string& text) {
  nlohmann::json keys = nlohmann::json::array();
  for (std::size_t at = 0; at < text.size();) {
    std::size_t end = at + 1;
    while (end < text.size() && (static_cast<unsigned char>(text[end]) & 0xC0U) == 0x80U) ++end;
    const std::string key = text.substr(at, end - at);
    keys.push_back({{"type", "keyDown"}, {"value", key}});
    keys.push_back({{"type", "keyUp"}, {"value", key}});
    at = end;
  }
  ask("POST", session_ + "/actions",
      {{"actions", {{{"type", "key"}, {"id", "keyboard"}, {"actions", keys}}}}});
}

nlohmann::json Browser::value(const std::string& expression) {
  return ask("POST", session_ + "/execute/sync",
             {{"script", "return " + expression}, {"args", nlohmann::json::array()}});
}

std::string Browser::text(const std::string& selector) {
  return value("document.querySelector('" + selector + "')?.textContent ?? ''").get<std::string>();
}

bool Browser::becomes(const std::string& expression, int seconds) {
  return support::eventually([&] { return value("Boolean(" + expression + ")") == true; },
                             std::chrono::seconds(seconds));
}

void Browser::prefer_dark(bool dark) {
  ask("POST", session_ + "/goog/cdp/execute",
      {{"cmd", "Emulation.setEmulatedMedia"},
       {"params", {{"features", {{{"name", "prefers-color-scheme"}, {"value", dark ? "dark" : "light"}}}}}}});
}

void Browser::save_picture(const std::string& file) {
  const std::string text = ask("GET", session_ + "/screenshot").get<std::string>();
  std::vector<unsigned char> picture(text.size());
  const int size = EVP_DecodeBlock(picture.data(), reinterpret_cast<const unsigned char*>(text.data()),
                                   static_cast<int>(text.size()));
  std::ofstream(file, std::ios::binary).write(reinterpret_cast<const char*>(picture.data()), size);
}

std::string Browser::complaints() {
  std::string found;
  for (const nlohmann::json& entry : ask("POST", session_ + "/se/log", {{"type", "browser"}}))
    found += entry.at("message").get<std::string>() + "\n";
  return found;
}

}  // namespace clampd::screen
