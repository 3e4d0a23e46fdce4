#include "proto/channel/connection_probe.h"

#include <zmq.hpp>

#include "proto/channel/socket.h"
#include "proto/channel/socket_events.h"

namespace trem {
namespace {

using Clock = std::chrono::steady_clock;

// Seen so often it is no accident, such as a coordinator that is just being started again.
constexpr int kOftenEnough = 3;
// A side that wants keys may close before its greeting is read, which then tells nothing of keys: a few tries more, and one is read.
constexpr int kBrokenOffEnough = 10;

// What the events so far add up to.
struct Seen {
  bool was_connected = false;
  bool other_mechanism = false;
  int refused = 0;     // No connection came to be.
  int broken_off = 0;  // One ended before hands were shaken.
  bool is_clear() const { return other_mechanism || refused >= kOftenEnough || broken_off >= kBrokenOffEnough; }
};

Reach Judge(const Seen& seen) {
  if (seen.other_mechanism) return Reach::kKeysDiffer;
  if (seen.was_connected) return Reach::kOtherKey;
  return seen.refused > 0 ? Reach::kNobodyListens : Reach::kNoWay;
}

}  // namespace

Result<Reach> ProbeConnection(const std::string& endpoint, const ChannelOptions& options, std::chrono::milliseconds patience) {
  TREM_RETURN_IF_ERROR(CheckDealer(endpoint, options));
  const auto deadline = Clock::now() + patience;
  try {
    zmq::context_t context;
    zmq::socket_t socket(context, zmq::socket_type::dealer);
    ConfigureSocket(&socket, endpoint, options);
    socket.set(zmq::sockopt::linger, 0);
    SocketEvents events(&context, &socket, ZMQ_EVENT_ALL);
    socket.connect(endpoint);
    Seen seen;
    while (Clock::now() < deadline && !seen.is_clear()) {
      SocketEvent event;
      if (!events.Next(std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now()), &event)) continue;
      switch (event.kind) {
        case ZMQ_EVENT_HANDSHAKE_SUCCEEDED:
          return Reach::kReady;
        case ZMQ_EVENT_HANDSHAKE_FAILED_AUTH:
          return Reach::kKeyNotAllowed;
        case ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL:
          seen.other_mechanism |= event.value == ZMQ_PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH;
          break;
        case ZMQ_EVENT_CONNECTED:
          seen.was_connected = true;
          break;
        case ZMQ_EVENT_CLOSED:
          ++seen.refused;
          break;
        case ZMQ_EVENT_DISCONNECTED:
          ++seen.broken_off;
          break;
        default:
          break;
      }
    }
    return Judge(seen);
  } catch (const zmq::error_t& error) {
    return InvalidInput("cannot connect to " + endpoint + ": " + error.what());
  }
}

}  // namespace trem
