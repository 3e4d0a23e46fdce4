#include "proto/channel/connection_monitor.h"

#include <sys/socket.h>

namespace trem {
namespace {

constexpr int kEvents = ZMQ_EVENT_ACCEPTED | ZMQ_EVENT_DISCONNECTED | ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL |
                        ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL | ZMQ_EVENT_HANDSHAKE_FAILED_AUTH;

}  // namespace

ConnectionMonitor::ConnectionMonitor(zmq::context_t* context, zmq::socket_t* socket, int connections_max)
    : events_(context, socket, kEvents), connections_max_(connections_max) {}

void ConnectionMonitor::Take(ChannelCounters* counters) {
  SocketEvent event;
  while (events_.Next({}, &event)) {
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
