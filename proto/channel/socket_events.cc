#include "proto/channel/socket_events.h"

#include <atomic>
#include <cerrno>
#include <cstring>
#include <string>

namespace trem {

SocketEvents::SocketEvents(zmq::context_t* context, zmq::socket_t* socket, int mask)
    : watched_(*socket), events_(*context, zmq::socket_type::pair) {
  static std::atomic<unsigned> counter{0};
  const std::string address = "inproc://connections-" + std::to_string(counter.fetch_add(1));
  if (zmq_socket_monitor(watched_.handle(), address.c_str(), mask) != 0) throw zmq::error_t();
  events_.set(zmq::sockopt::linger, 0);
  events_.set(zmq::sockopt::rcvhwm, 0);  // An event that is dropped would spoil the count.
  events_.connect(address);
}

SocketEvents::~SocketEvents() { (void)zmq_socket_monitor(watched_.handle(), nullptr, 0); }

// Two frames: kind and value, then the address.
bool SocketEvents::Next(std::chrono::milliseconds timeout, SocketEvent* event) {
  if (timeout.count() > 0) {
    zmq::pollitem_t item{events_.handle(), 0, ZMQ_POLLIN, 0};
    (void)zmq_poll(&item, 1, static_cast<long>(timeout.count()));
  }
  zmq::message_t frame;
  bool first = true;
  do {
    try {
      if (!events_.recv(frame, zmq::recv_flags::dontwait)) return false;
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

}  // namespace trem
