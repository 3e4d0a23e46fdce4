#include "coordinator/http/http_server.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <microhttpd.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cerrno>
#include <charconv>
#include <cstring>
#include <map>
#include <mutex>
#include <optional>
#include <string_view>
#include <utility>

namespace trem {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kConnectionMemoryBytes = 16 * 1024;
constexpr unsigned kIdleSecondsMax = 5;

struct Address {
  sockaddr_storage storage{};
  bool is_loopback = false;
  std::string host;  // As in a URL.

  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&storage); }
  bool is_ipv6() const { return storage.ss_family == AF_INET6; }
};

std::optional<Address> ParseAddress(std::string_view text) {
  const std::size_t colon = text.rfind(':');
  if (colon == std::string_view::npos) return std::nullopt;
  const std::string_view port_text = text.substr(colon + 1);
  std::uint16_t port = 0;
  const auto [end, error] = std::from_chars(port_text.data(), port_text.data() + port_text.size(), port);
  if (error != std::errc() || end != port_text.data() + port_text.size() || port_text.empty()) return std::nullopt;
  Address address;
  address.host = text.substr(0, colon);
  if (address.host.size() > 2 && address.host.front() == '[' && address.host.back() == ']') {
    auto* in6 = reinterpret_cast<sockaddr_in6*>(&address.storage);
    in6->sin6_family = AF_INET6;
    in6->sin6_port = htons(port);
    if (::inet_pton(AF_INET6, address.host.substr(1, address.host.size() - 2).c_str(), &in6->sin6_addr) != 1) return std::nullopt;
    address.is_loopback = IN6_IS_ADDR_LOOPBACK(&in6->sin6_addr);
    return address;
  }
  auto* in4 = reinterpret_cast<sockaddr_in*>(&address.storage);
  in4->sin_family = AF_INET;
  in4->sin_port = htons(port);
  if (::inet_pton(AF_INET, address.host.c_str(), &in4->sin_addr) != 1) return std::nullopt;
  address.is_loopback = (ntohl(in4->sin_addr.s_addr) >> 24) == IN_LOOPBACKNET;
  return address;
}

}  // namespace

struct HttpServer::State {
  HttpServerOptions options;
  Handler handler;
  std::string url;
  MHD_Daemon* daemon = nullptr;
  std::mutex mutex;
  std::map<int, Clock::time_point> opened_at;  // By descriptor, which MHD keeps open until it has told us.

  static MHD_Result Answer(void* self, MHD_Connection* connection, const char* path, const char* method, const char* version,
                           const char* upload, std::size_t* upload_bytes, void** request);
  static void Notify(void* self, MHD_Connection* connection, void** context, MHD_ConnectionNotificationCode code);
};

MHD_Result HttpServer::State::Answer(void* self, MHD_Connection* connection, const char* path, const char* method, const char*, const char*,
                                     std::size_t*, void**) {
  HttpResponse answer;
  if (std::strcmp(method, MHD_HTTP_METHOD_GET) == 0 || std::strcmp(method, MHD_HTTP_METHOD_HEAD) == 0) {
    answer = static_cast<State*>(self)->handler(path);
  } else {
    answer = {MHD_HTTP_METHOD_NOT_ALLOWED, "text/plain; charset=utf-8", "only GET and HEAD are served here\n"};
  }
  MHD_Response* response =
      MHD_create_response_from_buffer(answer.body.size(), const_cast<char*>(answer.body.data()), MHD_RESPMEM_MUST_COPY);
  if (response == nullptr) return MHD_NO;
  MHD_add_response_header(response, MHD_HTTP_HEADER_CONTENT_TYPE, answer.content_type.c_str());
  if (answer.status == MHD_HTTP_METHOD_NOT_ALLOWED) MHD_add_response_header(response, MHD_HTTP_HEADER_ALLOW, "GET, HEAD");
  const MHD_Result result = MHD_queue_response(connection, static_cast<unsigned>(answer.status), response);
  MHD_destroy_response(response);
  return result;
}

void HttpServer::State::Notify(void* self, MHD_Connection* connection, void**, MHD_ConnectionNotificationCode code) {
  auto* state = static_cast<State*>(self);
  const MHD_ConnectionInfo* info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
  if (info == nullptr) return;
  const std::lock_guard lock(state->mutex);
  if (code == MHD_CONNECTION_NOTIFY_STARTED) {
    state->opened_at[info->connect_fd] = Clock::now();
  } else {
    state->opened_at.erase(info->connect_fd);
  }
}

HttpServer::HttpServer(std::unique_ptr<State> state) : state_(std::move(state)) {}

HttpServer::~HttpServer() {
  if (state_->daemon != nullptr) MHD_stop_daemon(state_->daemon);
}

Result<std::unique_ptr<HttpServer>> HttpServer::Start(const HttpServerOptions& options, Handler handler) {
  const std::optional<Address> address = ParseAddress(options.address);
  if (!address) {
    return InvalidInput("'" + options.address +
                        "' is not an address to serve HTTP on; expected HOST:PORT with a numeric host, as in 127.0.0.1:9411");
  }
  if (!address->is_loopback && !options.open) {
    return InvalidInput("HTTP on " + options.address +
                        " could be read by other machines without a key; add --http-open if they may, or use 127.0.0.1");
  }
  auto state = std::make_unique<State>();
  state->options = options;
  state->handler = std::move(handler);
  const unsigned flags = MHD_USE_EPOLL_INTERNAL_THREAD | (address->is_ipv6() ? static_cast<unsigned>(MHD_USE_IPv6) : 0U);
  state->daemon = MHD_start_daemon(flags, 0, nullptr, nullptr, &State::Answer, state.get(),     //
                                   MHD_OPTION_SOCK_ADDR, address->get(),                        //
                                   MHD_OPTION_CONNECTION_LIMIT, options.connections_max,        //
                                   MHD_OPTION_CONNECTION_TIMEOUT, kIdleSecondsMax,              //
                                   MHD_OPTION_CONNECTION_MEMORY_LIMIT, kConnectionMemoryBytes,  //
                                   MHD_OPTION_NOTIFY_CONNECTION, &State::Notify, state.get(),   //
                                   MHD_OPTION_LISTENING_ADDRESS_REUSE, 1U, MHD_OPTION_END);
  if (state->daemon == nullptr) return Unavailable("cannot serve HTTP on " + options.address + ": " + std::strerror(errno));
  const MHD_DaemonInfo* info = MHD_get_daemon_info(state->daemon, MHD_DAEMON_INFO_BIND_PORT);
  state->url = fmt::format("http://{}:{}", address->host, info == nullptr ? 0 : info->port);
  return std::unique_ptr<HttpServer>(new HttpServer(std::move(state)));
}

const std::string& HttpServer::url() const { return state_->url; }

void HttpServer::CloseOldConnections() {
  const auto now = Clock::now();
  const std::lock_guard lock(state_->mutex);
  for (const auto& [fd, opened_at] : state_->opened_at) {
    // MHD sees the end of the stream and closes the descriptor.
    if (now - opened_at > state_->options.lifetime_max) ::shutdown(fd, SHUT_RDWR);
  }
}

}  // namespace trem
