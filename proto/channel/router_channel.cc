#include "proto/channel/router_channel.h"

#include <cerrno>
#include <utility>

#include "proto/channel/socket.h"

namespace trem {

struct RouterChannel::State {
  ChannelOptions options;
  WakeEvent wake;
  zmq::context_t context;
  zmq::socket_t socket{context, zmq::socket_type::router};
  std::string endpoint;
  std::uint64_t garbage_count = 0;
};

RouterChannel::RouterChannel(std::unique_ptr<State> state) : state_(std::move(state)) {}
RouterChannel::~RouterChannel() = default;

Result<std::unique_ptr<RouterChannel>> RouterChannel::Bind(const std::string& endpoint, const ChannelOptions& options) {
  TREM_RETURN_IF_ERROR(CheckEndpoint(endpoint, /*wildcard_port=*/true));
  auto state = std::make_unique<State>();
  state->options = options;
  try {
    ConfigureSocket(&state->socket, options);
    // A vanished peer is reported instead of silently dropped; a peer that comes back under its name takes over from its dead connection.
    state->socket.set(zmq::sockopt::router_mandatory, true);
    state->socket.set(zmq::sockopt::router_handover, true);
    state->socket.bind(endpoint);
    state->endpoint = state->socket.get(zmq::sockopt::last_endpoint);
  } catch (const zmq::error_t& error) {
    const std::string what = "cannot listen on " + endpoint + ": " + error.what();
    if (error.num() == EADDRINUSE) return Unavailable(what + "; another program listens there");
    return InvalidInput(what);
  }
  return std::unique_ptr<RouterChannel>(new RouterChannel(std::move(state)));
}

const std::string& RouterChannel::endpoint() const { return state_->endpoint; }

std::optional<RouterChannel::Incoming> RouterChannel::Poll(std::chrono::milliseconds timeout) {
  constexpr std::size_t kFrameCount = 3;  // Identity, header, body.
  RawMessage message;
  if (!WaitFor(&state_->socket, state_->wake, ZMQ_POLLIN, timeout) || !ReceiveNow(&state_->socket, kFrameCount, &message))
    return std::nullopt;
  Incoming incoming{message.frames.front(), Corrupt("a message that does not consist of two frames")};
  if (message.is_complete && message.frames.size() == kFrameCount) {
    incoming.envelope = DecodeEnvelope(message.frames[1], message.frames[2], state_->options.limits);
  }
  if (!incoming.envelope.ok()) ++state_->garbage_count;
  return incoming;
}

bool RouterChannel::Send(const std::string& peer, const v1::Envelope& envelope) {
  const EnvelopeFrames frames = EncodeEnvelope(envelope);
  constexpr auto kMore = zmq::send_flags::sndmore | zmq::send_flags::dontwait;
  try {
    // The first frame chooses the peer: when it is taken, the others are.
    if (!state_->socket.send(zmq::buffer(peer), kMore)) return false;
    return state_->socket.send(zmq::buffer(frames.header), kMore).has_value() &&
           state_->socket.send(zmq::buffer(frames.body), zmq::send_flags::dontwait).has_value();
  } catch (const zmq::error_t&) {
    return false;  // EHOSTUNREACH: the peer is gone.
  }
}

void RouterChannel::Wake() const { state_->wake.Notify(); }

std::uint64_t RouterChannel::garbage_count() const { return state_->garbage_count; }

}  // namespace trem
