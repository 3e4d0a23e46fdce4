#include "proto/channel/socket.h"

#include <fmt/format.h>
#include <sys/un.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <limits>
#include <string_view>

namespace trem {
namespace {

// True for a decimal number from 0 to `most`, without sign or spaces.
bool IsNumber(std::string_view text, unsigned most) {
  unsigned value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && value <= most;
}

// True for 127.x.y.z.
bool IsIpv4Loopback(std::string_view host) {
  int parts = 0;
  bool is_loopback = host.starts_with("127.");
  while (is_loopback) {
    const std::size_t dot = host.find('.');
    is_loopback = IsNumber(host.substr(0, dot), 255);
    ++parts;
    if (dot == std::string_view::npos) break;
    host.remove_prefix(dot + 1);
  }
  return is_loopback && parts == 4;
}

// A name, an IPv4 address, or an IPv6 address in brackets; libzmq finds out whether it exists.
bool IsHost(std::string_view host, bool wildcard) {
  constexpr std::size_t kHostBytesMax = 253;
  if (host.empty() || host.size() > kHostBytesMax) return false;
  if (wildcard && host == "*") return true;
  const bool bracketed = host.front() == '[' && host.back() == ']' && host.size() > 2;
  if (bracketed) host = host.substr(1, host.size() - 2);
  return std::all_of(host.begin(), host.end(), [bracketed](unsigned char c) {
    if (bracketed) return std::isxdigit(c) != 0 || c == ':' || c == '.';
    return c < 0x80 && (std::isalnum(c) != 0 || c == '.' || c == '-');
  });
}

Status CheckIpc(const std::string& endpoint, std::string_view path) {
  constexpr std::size_t kPathBytesMax = sizeof(sockaddr_un::sun_path) - 1;
  if (path.empty()) return InvalidInput(fmt::format("endpoint '{}' has no path; expected ipc://PATH", endpoint));
  if (path.size() > kPathBytesMax) {
    return InvalidInput(fmt::format("endpoint '{}': a socket's path has at most {} bytes, this one has {}; use a shorter folder", endpoint,
                                    kPathBytesMax, path.size()));
  }
  return {};
}

// False when no frame is there.
bool ReceiveFrame(zmq::socket_t* socket, zmq::message_t* frame) {
  for (;;) {
    try {
      return socket->recv(*frame, zmq::recv_flags::dontwait).has_value();
    } catch (const zmq::error_t& error) {
      if (error.num() != EINTR) return false;
    }
  }
}

std::string UserOf(const zmq::message_t& frame) {
  // Null without metadata; cppzmq's gets() would throw.
  const char* user = zmq_msg_gets(frame.handle(), "User-Id");
  return user == nullptr ? std::string() : std::string(user);
}

}  // namespace

Status CheckEndpoint(const std::string& endpoint, bool wildcard_port, bool has_keys) {
  constexpr std::string_view kIpc = "ipc://";
  constexpr std::string_view kTcp = "tcp://";
  const std::string_view text = endpoint;
  if (text.starts_with(kIpc)) return CheckIpc(endpoint, text.substr(kIpc.size()));
  const std::size_t colon = text.rfind(':');
  if (!text.starts_with(kTcp) || colon < kTcp.size()) {
    return InvalidInput(fmt::format("endpoint '{}' is not understood; expected ipc://PATH or tcp://127.0.0.1:PORT", endpoint));
  }
  const std::string_view host = text.substr(kTcp.size(), colon - kTcp.size());
  const std::string_view port = text.substr(colon + 1);
  if (!IsIpv4Loopback(host) && !has_keys) {
    return InvalidInput(
        fmt::format("endpoint '{}' is neither ipc nor an IPv4 loopback address: connections between machines need keys (`trem keys`, "
                    "docs/SECURITY.md); name them with --key, or use ipc://PATH or tcp://127.0.0.1:PORT",
                    endpoint));
  }
  if (!IsHost(host, wildcard_port)) {
    return InvalidInput(fmt::format("endpoint '{}' has the host '{}'; expected a name, an address{} or an IPv6 address in brackets",
                                    endpoint, host, wildcard_port ? ", *" : ""));
  }
  if (wildcard_port && port == "*") return {};
  if (!IsNumber(port, 65535) || port == "0") {
    return InvalidInput(
        fmt::format("endpoint '{}' has the port '{}'; expected a number from 1 to 65535{}", endpoint, port, wildcard_port ? " or *" : ""));
  }
  return {};
}

Status CheckDealer(const std::string& endpoint, const ChannelOptions& options) {
  TREM_RETURN_IF_ERROR(CheckEndpoint(endpoint, /*wildcard_port=*/false, options.own_key.has_value()));
  if (!options.own_key || !options.coordinator_public_key.empty()) return {};
  return InvalidInput("a key is of use only with the coordinator's public key, by which an impostor is told from it");
}

void ConfigureSocket(zmq::socket_t* socket, const std::string& endpoint, const ChannelOptions& options) {
  // The sum over peers is bounded by their number.
  socket->set(zmq::sockopt::linger, static_cast<int>(options.linger.count()));
  socket->set(zmq::sockopt::rcvhwm, options.messages_unread_max);
  socket->set(zmq::sockopt::sndhwm, options.messages_unsent_max);
  // A connection that has not shaken hands by then is closed.
  socket->set(zmq::sockopt::handshake_ivl, static_cast<int>(options.handshake_timeout.count()));
  // Machines that went away without a word are noticed after about two minutes.
  socket->set(zmq::sockopt::tcp_keepalive, 1);
  socket->set(zmq::sockopt::tcp_keepalive_idle, 60);
  socket->set(zmq::sockopt::tcp_keepalive_intvl, 15);
  socket->set(zmq::sockopt::tcp_keepalive_cnt, 4);
  if (endpoint.find('[') != std::string::npos) socket->set(zmq::sockopt::ipv6, true);
  if (options.own_key) {
    socket->set(zmq::sockopt::curve_publickey, options.own_key->public_key());
    socket->set(zmq::sockopt::curve_secretkey, options.own_key->secret_key());
    if (!options.coordinator_public_key.empty()) socket->set(zmq::sockopt::curve_serverkey, options.coordinator_public_key);
  }
  // A peer that sends a larger frame is disconnected by libzmq before the frame is allocated.
  socket->set(zmq::sockopt::maxmsgsize, static_cast<std::int64_t>(options.limits.body_bytes_max));
  socket->set(zmq::sockopt::reconnect_ivl, 50);
  socket->set(zmq::sockopt::reconnect_ivl_max, 2000);
}

bool WaitFor(zmq::socket_t* socket, const WakeEvent& wake, short events, std::chrono::milliseconds timeout) {
  zmq::pollitem_t items[] = {{socket->handle(), 0, events, 0}, {nullptr, wake.fd(), ZMQ_POLLIN, 0}};
  const auto bounded = std::clamp<std::chrono::milliseconds::rep>(timeout.count(), 0, std::numeric_limits<int>::max());
  const int ready = zmq_poll(items, 2, static_cast<long>(bounded));
  if (ready <= 0) return false;  // Time is over, or a signal interrupted the wait.
  if ((items[0].revents & events) != 0) return true;
  wake.Clear();
  return false;
}

bool ReceiveNow(zmq::socket_t* socket, std::size_t frames_max, RawMessage* message) {
  *message = {};
  for (bool more = true; more;) {  // The frames of one message arrive together: only the first can be missing.
    zmq::message_t frame;
    if (!ReceiveFrame(socket, &frame)) return false;
    more = frame.more();
    if (!more) message->user = UserOf(frame);
    if (message->frames.size() < frames_max) {
      message->frames.push_back(frame.to_string());
    } else if (!message->payload) {
      message->payload = std::move(frame);
    } else {
      message->is_complete = false;
    }
  }
  return true;
}

bool ReceiveNext(zmq::socket_t* socket, const WakeEvent& wake, std::chrono::milliseconds timeout, std::size_t frames_max,
                 RawMessage* message) {
  // Where messages come one after the other, asking whether there is one would cost more than taking it.
  if (ReceiveNow(socket, frames_max, message)) return true;
  return WaitFor(socket, wake, ZMQ_POLLIN, timeout) && ReceiveNow(socket, frames_max, message);
}

Result<v1::Envelope> DecodeMessage(RawMessage message, std::size_t frame_count, const EnvelopeLimits& limits, Payload* payload) {
  if (!message.is_complete || message.frames.size() != frame_count) {
    return Corrupt("a message that does not consist of two frames, or three with the bytes of a chunk");
  }
  TREM_ASSIGN_OR_RETURN(v1::Envelope envelope, DecodeEnvelope(message.frames[frame_count - 2], message.frames[frame_count - 1], limits));
  TREM_RETURN_IF_ERROR(
      ValidatePayload(envelope, message.payload ? std::optional<std::size_t>(message.payload->size()) : std::optional<std::size_t>()));
  if (message.payload) *payload = Payload(std::move(*message.payload));
  return envelope;
}

bool SendNow(zmq::socket_t* socket, const std::string* peer, const EnvelopeFrames& frames, Payload* payload) {
  constexpr auto kMore = zmq::send_flags::sndmore | zmq::send_flags::dontwait;
  if (peer != nullptr && !socket->send(zmq::buffer(*peer), kMore)) return false;
  if (!socket->send(zmq::buffer(frames.header), kMore)) return false;
  if (payload == nullptr) return socket->send(zmq::buffer(frames.body), zmq::send_flags::dontwait).has_value();
  return socket->send(zmq::buffer(frames.body), kMore).has_value() && socket->send(payload->frame(), zmq::send_flags::dontwait).has_value();
}

}  // namespace trem
