#pragma once

#include <zmq.hpp>

#include "proto/channel/router_channel.h"
#include "proto/channel/socket_events.h"

namespace trem {

// Counts the connections of a listening socket from libzmq's events, and closes those beyond a limit. For the thread that owns the socket.
class ConnectionMonitor {
 public:
  // Watches `socket`, which must outlive this object; throws zmq::error_t. Make it before the socket is bound.
  ConnectionMonitor(zmq::context_t* context, zmq::socket_t* socket, int connections_max);

  // Adds what has happened since the last call. Call often: a connection beyond the limit lives until then.
  void Take(ChannelCounters* counters);

 private:
  SocketEvents events_;
  int connections_max_;
};

}  // namespace trem
