// Goal: the HTTP server answers, refuses what it should, and goes on answering while others hold connections open. Method: real sockets on
// loopback, with requests written by hand, good and bad.
#include "coordinator/http/http_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <thread>
#include <vector>

#include "tests/support/loopback.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

class HttpServerTest : public ::testing::Test {
 protected:
  void Start(HttpServerOptions options = {}) {
    options.address = "127.0.0.1:0";
    auto made = HttpServer::Start(options, [](const std::string& path) -> HttpResponse {
      if (path == "/large") return {200, "text/plain", std::string(1 << 20, 'x')};
      return path == "/here" ? HttpResponse{200, "text/plain", "answer\n"} : HttpResponse{404, "text/plain", "no\n"};
    });
    TREM_CHECK_MSG(made.ok(), made.status().message());
    server_ = std::move(made).value();
  }
  std::string Ask(const std::string& request) const { return testing::Exchange(server_->url(), request); }
  std::string Get(const std::string& path) const { return testing::HttpGet(server_->url(), path); }

  std::unique_ptr<HttpServer> server_;
};

TEST_F(HttpServerTest, AnswersGetAndHead) {
  Start();
  EXPECT_THAT(Get("/here"), StartsWith("HTTP/1.1 200"));
  EXPECT_THAT(Get("/here?x=1"), HasSubstr("answer"));
  EXPECT_THAT(Get("/there"), StartsWith("HTTP/1.1 404"));
  EXPECT_GT(Get("/large").size(), std::size_t{1} << 20);
  EXPECT_THAT(Ask("HEAD /here HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"), StartsWith("HTTP/1.1 200"));
}

TEST_F(HttpServerTest, RefusesWhatItIsNotFor) {
  Start();
  for (const char* method : {"POST", "PUT", "DELETE", "TRACE"}) {
    EXPECT_THAT(Ask(std::string(method) + " /here HTTP/1.1\r\nHost: x\r\nContent-Length: 3\r\nConnection: close\r\n\r\nabc"),
                StartsWith("HTTP/1.1 405"));
  }
  EXPECT_THAT(Ask("GET /here HTTP/1.1\r\nHost: x\r\nLong: " + std::string(100'000, 'x') + "\r\n\r\n"), StartsWith("HTTP/1.1 4"));
  for (const std::string& garbage : {std::string("\x16\x03\x01\x02\0", 5), std::string(50'000, '\n'), std::string("GET\r\n\r\n")}) {
    const int fd = testing::ConnectLoopback(server_->url());
    (void)!::send(fd, garbage.data(), garbage.size(), MSG_NOSIGNAL);
    ::close(fd);
  }
  EXPECT_THAT(Get("/here"), HasSubstr("answer"));
}

TEST_F(HttpServerTest, OutlastsSlowRequests) {
  HttpServerOptions options;
  options.connections_max = 16;
  options.lifetime_max = std::chrono::milliseconds(200);
  Start(options);
  std::atomic<bool> stop{false};
  // Fifty clients that never finish their headers; each sends a byte every 20 ms, so none is ever idle.
  std::thread crowd([&] {
    std::vector<int> sockets;
    for (int i = 0; i < 50; ++i) {
      sockets.push_back(testing::ConnectLoopback(server_->url()));
      (void)!::send(sockets.back(), "GET /here HTTP/1.1\r\nX: ", 23, MSG_NOSIGNAL);
    }
    while (!stop) {
      for (const int fd : sockets) (void)!::send(fd, "x", 1, MSG_NOSIGNAL);
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      server_->CloseOldConnections();
    }
    for (const int fd : sockets) ::close(fd);
  });
  std::string answer;
  for (int i = 0; i < 200 && answer.find("answer") == std::string::npos; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    answer = Get("/here");
  }
  stop = true;
  crowd.join();
  EXPECT_THAT(answer, HasSubstr("answer"));
}

TEST_F(HttpServerTest, ListensBeyondThisMachineOnlyWhenTold) {
  const auto handler = [](const std::string&) { return HttpResponse{}; };
  EXPECT_THAT(HttpServer::Start({"0.0.0.0:0"}, handler).status().message(), HasSubstr("--http-open"));
  EXPECT_TRUE(HttpServer::Start({"0.0.0.0:0", true}, handler).ok());
  for (const char* address : {"", "127.0.0.1", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:70000", "localhost:1", ":1", "127.0.0.1:1x"}) {
    EXPECT_EQ(HttpServer::Start({address, true}, handler).status().code(), StatusCode::kInvalidInput) << address;
  }
}

}  // namespace
}  // namespace trem
