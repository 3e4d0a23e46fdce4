#include "proto/channel/connection_monitor.h"

#include <sys/socket.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <string>

namespace trem {
namespace {

struct SocketEvent {
  std::uint16_t kind = 0;
  std::uint32_t value = 0;
};

// Two frames: kind and value, then the address.
bool NextEvent(zmq::socket_t* events, SocketEvent* event) {
  zmq::message_t frame;
  bool first = true;
  do {
    try {
      if (!events->recv(frame, zmq::recv_flags::dontwait)) return false;
    } catch (const zmq::error_t& error) {
      if (error.num() == EINTR) continue;
      return false;
    }
    if (first && frame.size() >= sizeof(event->kind) + sizeof(event->value)) {
      std::memcpy(&event->kind, frame.data(), sizeof(event->kind));
      std::memcpy(&event->value, static_cast<const char*>(frame.data()) + sizeof(event->kind), sizeof(event->value));
    }
    first = false;
  } while (first || frame.more());
  return true;
}

}  // namespace

ConnectionMonitor::ConnectionMonitor(zmq::context_t* context, zmq::socket_t* socket, int connections_max)
    : watched_(*socket), events_(*context, zmq::socket_type::pair), connections_max_(connections_max) {
  static std::atomic<unsigned> counter{0};
  const std::string address = "inproc://connections-" + std::to_string(counter.fetch_add(1));
  constexpr int kEvents = ZMQ_EVENT_ACCEPTED | ZMQ_EVENT_DISCONNECTED | ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL |
                          ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL | ZMQ_EVENT_HANDSHAKE_FAILED_AUTH;
  if (zmq_socket_monitor(watched_.handle(), address.c_str(), kEvents) != 0) throw zmq::error_t();
  events_.set(zmq::sockopt::linger, 0);
  events_.set(zmq::sockopt::rcvhwm, 0);  // An event that is dropped would spoil the count.
  events_.connect(address);
}

ConnectionMonitor::~ConnectionMonitor() { (void)zmq_socket_monitor(watched_.handle(), nullptr, 0); }

void ConnectionMonitor::Take(ChannelCounters* counters) {
  SocketEvent event;
  while (NextEvent(&events_, &event)) {
    switch (event.kind) {
      case ZMQ_EVENT_ACCEPTED:
        ++counters->accepted;
        ++counters->connections;
        if (counters->connections <= static_cast<std::uint64_t>(connections_max_)) break;
        // libzmq owns the descriptor and closes it when it sees the end of the stream. Should it have done so by now, then whatever has
        // the number is another connection, which comes back, or no socket, to which this does nothing.
        ::shutdown(static_cast<int>(event.value), SHUT_RDWR);
        ++counters->refused_full;
        break;
      case ZMQ_EVENT_DISCONNECTED:
        if (counters->connections > 0) --counters->connections;
        break;
      default:
        ++counters->handshakes_failed;
    }
  }
}

}  // namespace trem
