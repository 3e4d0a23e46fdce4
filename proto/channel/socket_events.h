#pragma once

#include <chrono>
#include <cstdint>
#include <zmq.hpp>

namespace trem {

// One of libzmq's ZMQ_EVENT_... and what came with it (a descriptor, an error, a status).
struct SocketEvent {
  std::uint16_t kind = 0;
  std::uint32_t value = 0;
};

// What libzmq tells of a socket's connections. For the thread that owns the socket.
class SocketEvents {
 public:
  // Of `socket`, which must outlive this object, the events in `mask`; throws zmq::error_t. Make it before the socket is bound or
  // connected.
  SocketEvents(zmq::context_t* context, zmq::socket_t* socket, int mask);
  ~SocketEvents();
  SocketEvents(const SocketEvents&) = delete;
  SocketEvents& operator=(const SocketEvents&) = delete;

  // The next event, waiting for it at most so long; false when there was none.
  bool Next(std::chrono::milliseconds timeout, SocketEvent* event);

 private:
  zmq::socket_t& watched_;
  zmq::socket_t events_;
};

}  // namespace trem
