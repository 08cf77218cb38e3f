#include "clampd/http/client.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/basic_stream.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>

namespace clampd::http {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
using asio::ip::tcp;
using boost::system::error_code;
using Executor = asio::io_context::executor_type;

beast::http::request<beast::http::string_body> message(const std::string& address, int port,
                                                       const Call& call) {
  beast::http::request<beast::http::string_body> request;
  request.method_string(call.method);
  request.target(call.path);
  request.version(11);
  const std::string host = address.find(':') == std::string::npos ? address : "[" + address + "]";
  request.set(beast::http::field::host, fmt::format("{}:{}", host, port));
  request.set(beast::http::field::connection, "close");
  const bool has_body = !call.body.empty() || call.method == "POST";
  if (has_body) request.set(beast::http::field::content_type, "application/json");
  for (const auto& [name, value] : call.headers) request.set(name, value);
  request.body() = call.body;
  if (has_body) request.content_length(call.body.size());
  return request;
}

/// One exchange; each step begins the next, under the time that the stream has for it.
class Exchange {
 public:
  Exchange(asio::io_context& context, const std::string& address, int port, const Call& call)
      : call_(call), stream_(context), request_(message(address, port, call)) {
    parser_.body_limit(call.answer_max);
    if (call.method == "HEAD") parser_.skip(true);
  }

  void begin(const asio::ip::basic_resolver_results<tcp>& where) {
    stream_.expires_after(call_.connect_within);
    stream_.async_connect(where, [this](const error_code& error, const tcp::endpoint&) {
      if (error) return end(error);
      stream_.expires_after(call_.answer_within);
      beast::http::async_write(stream_, request_, [this](const error_code&, std::size_t) { receive(); });
    });
  }

  Result<Answer> outcome() {
    if (error_)
      return failure(error_ == beast::error::timeout ? "it did not answer in time" : error_.message());
    auto response = parser_.release();
    Answer answer{static_cast<int>(response.result_int()), std::move(response.body())};
    for (const auto& field : response)
      answer.headers.emplace_back(std::string(field.name_string()), std::string(field.value()));
    return answer;
  }

 private:
  /// Also after a request that could not be sent as a whole: the server may have said why.
  void receive() {
    beast::http::async_read(stream_, buffer_, parser_,
                            [this](const error_code& error, std::size_t) { end(error); });
  }
  void end(const error_code& error) { error_ = error; }

  const Call& call_;
  beast::basic_stream<tcp, Executor> stream_;
  beast::http::request<beast::http::string_body> request_;
  beast::http::response_parser<beast::http::string_body> parser_;
  beast::flat_buffer buffer_;
  error_code error_;
};

}  // namespace

std::string Answer::header(const std::string& name) const {
  for (const auto& [known, value] : headers)
    if (beast::iequals(known, name)) return value;
  return "";
}

Result<Answer> exchange(const std::string& address, int port, const Call& call) {
  try {
    asio::io_context context{1};
    asio::ip::basic_resolver<tcp, Executor> resolver(context);
    error_code error;
    const auto where = resolver.resolve(address, std::to_string(port), tcp::resolver::numeric_service, error);
    if (error) return failure(error.message());
    Exchange exchange(context, address, port, call);
    exchange.begin(where);
    context.run();
    return exchange.outcome();
  } catch (const std::exception& thrown) {
    return failure(thrown.what());
  }
}

}  // namespace clampd::http
