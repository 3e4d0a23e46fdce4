#include "tests/support/loopback.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "mosaic/base/check.h"

namespace trem::testing {

int ConnectLoopback(const std::string& url) {
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  TREM_CHECK_MSG(fd >= 0, "no more sockets");
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(url.substr(url.rfind(':') + 1))));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  TREM_CHECK_MSG(::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0, url);
  const timeval timeout{20, 0};
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof(timeout));
  return fd;
}

int FreeLoopbackPort() {
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  TREM_CHECK(::bind(fd, reinterpret_cast<const sockaddr*>(&address), size) == 0);
  TREM_CHECK(::getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) == 0);
  ::close(fd);
  return ntohs(address.sin_port);
}

std::string Exchange(const std::string& url, const std::string& request) {
  const int fd = ConnectLoopback(url);
  (void)!::send(fd, request.data(), request.size(), MSG_NOSIGNAL);
  std::string answer;
  char block[65536];
  for (ssize_t count = 0; (count = ::recv(fd, block, sizeof(block), 0)) > 0;) answer.append(block, static_cast<std::size_t>(count));
  ::close(fd);
  return answer;
}

std::string HttpGet(const std::string& url, const std::string& path) {
  return Exchange(url, "GET " + path + " HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
}

}  // namespace trem::testing
