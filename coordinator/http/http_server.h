#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "mosaic/base/status.h"

namespace trem {

struct HttpResponse {
  int status = 200;
  std::string content_type = "text/plain; charset=utf-8";
  std::string body;
};

struct HttpServerOptions {
  std::string address;  // HOST:PORT with a numeric host, port 0 for any free one; "127.0.0.1:9411", "[::1]:9411".
  // Accept an address that other machines reach. What is served there is not secret, but neither encrypted nor authenticated.
  bool open = false;
  unsigned connections_max = 256;
  // A connection is closed after this, whatever it does: somebody who sends a byte now and then holds a place no longer.
  std::chrono::milliseconds lifetime_max{10'000};
};

// Answers GET and HEAD, on a thread of its own (libmicrohttpd). For metrics and probes: requests have no bodies, and headers of more than a
// few kilobytes are refused.
class HttpServer {
 public:
  // Called on the server's thread with the path, without query.
  using Handler = std::function<HttpResponse(const std::string& path)>;

  // Errors: kInvalidInput for an address that is none, or not loopback without `open`; kUnavailable when it is taken.
  static Result<std::unique_ptr<HttpServer>> Start(const HttpServerOptions& options, Handler handler);
  ~HttpServer();
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  // "http://127.0.0.1:9411", with the real port.
  const std::string& url() const;
  // Closes connections that are older than they may be. Call every second or so, from any thread.
  void CloseOldConnections();

 private:
  struct State;
  explicit HttpServer(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace trem
