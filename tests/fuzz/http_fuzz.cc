// Goal: no bytes on the line of metrics and probes harm the server: it answers in HTTP or closes, and answers the next one. Method: a
// server on loopback; each input is a connection's whole traffic.
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <memory>
#include <string>

#include "coordinator/http/http_server.h"
#include "mosaic/base/check.h"
#include "tests/fuzz/connection.h"

namespace {

std::unique_ptr<trem::HttpServer> StartServer() {
  trem::HttpServerOptions options;
  options.address = "127.0.0.1:0";
  auto server = trem::HttpServer::Start(options, [](const std::string& path) {
    return path == "/healthz" ? trem::HttpResponse{200, "text/plain", "ok\n"} : trem::HttpResponse{404, "text/plain", "no\n"};
  });
  TREM_CHECK_MSG(server.ok(), server.status().ToString());
  return std::move(server).value();
}

// What comes back when these bytes are all that is said.
std::string Exchange(const std::string& url, const std::string& bytes, int patience_ms) {
  const int fd = trem::fuzz::ConnectTo(url);
  (void)::send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL);
  ::shutdown(fd, SHUT_WR);
  // A connection that is kept alive is not closed from the other side: what comes within this is the answer.
  const timeval patience{patience_ms / 1000, patience_ms % 1000 * 1000};
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  std::string answer;
  std::array<char, 4096> buffer;
  for (ssize_t count = 0; (count = ::recv(fd, buffer.data(), buffer.size(), 0)) > 0;)
    answer.append(buffer.data(), static_cast<std::size_t>(count));
  ::close(fd);
  return answer;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const std::unique_ptr<trem::HttpServer> server = StartServer();
  const std::string answer = Exchange(server->url(), std::string(reinterpret_cast<const char*>(data), size), 20);
  TREM_CHECK_MSG(answer.empty() || answer.starts_with("HTTP/1."), answer.substr(0, 80));
  static unsigned count = 0;
  if (++count % 64 == 0)
    TREM_CHECK(Exchange(server->url(), "GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n", 10'000).find("ok\n") !=
               std::string::npos);
  return 0;
}
