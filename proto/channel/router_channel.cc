#include "proto/channel/router_channel.h"

#include <sys/stat.h>

#include <cerrno>
#include <utility>

#include "proto/channel/authenticator.h"
#include "proto/channel/connection_monitor.h"
#include "proto/channel/socket.h"

namespace trem {

struct RouterChannel::State {
  explicit State(const ChannelOptions& channel_options) : options(channel_options) {}

  ChannelOptions options;
  WakeEvent wake;
  zmq::context_t context;
  std::unique_ptr<Authenticator> authenticator;  // Outlives the socket, whose peers it judges.
  zmq::socket_t socket{context, zmq::socket_type::router};
  std::unique_ptr<ConnectionMonitor> monitor;
  std::string endpoint;
  ChannelCounters counters;
};

namespace {

// libzmq makes the file of an ipc socket with the process' umask.
class PrivateFilesScope {
 public:
  PrivateFilesScope() : umask_(::umask(0177)) {}
  ~PrivateFilesScope() { ::umask(umask_); }
  PrivateFilesScope(const PrivateFilesScope&) = delete;
  PrivateFilesScope& operator=(const PrivateFilesScope&) = delete;

 private:
  mode_t umask_;
};

}  // namespace

RouterChannel::RouterChannel(std::unique_ptr<State> state) : state_(std::move(state)) {}
RouterChannel::~RouterChannel() = default;

Result<std::unique_ptr<RouterChannel>> RouterChannel::Bind(const std::string& endpoint, const ChannelOptions& options) {
  TREM_RETURN_IF_ERROR(CheckEndpoint(endpoint, /*wildcard_port=*/true, options.own_key.has_value()));
  if (options.own_key && !options.allow_list) return InvalidInput("a coordinator with a key needs a list of the keys that it lets in");
  auto state = std::make_unique<State>(options);
  try {
    ConfigureSocket(&state->socket, endpoint, options);
    // A vanished peer is reported instead of silently dropped. Nobody takes over another's connection: names are libzmq's own, and a peer
    // that claims one that is in use is ignored.
    state->socket.set(zmq::sockopt::router_mandatory, true);
    if (options.own_key) {
      state->authenticator = std::make_unique<Authenticator>(&state->context, options.allow_list);
      state->socket.set(zmq::sockopt::curve_server, true);
      state->socket.set(zmq::sockopt::zap_domain, "trem");
    }
    state->monitor = std::make_unique<ConnectionMonitor>(&state->context, &state->socket, options.connections_max);
    const PrivateFilesScope private_files;
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
  state_->monitor->Take(&state_->counters);
  RawMessage message;
  if (!ReceiveNext(&state_->socket, state_->wake, timeout, kFrameCount, &message)) return std::nullopt;
  Incoming incoming{message.frames.front(), Corrupt("not decoded"), {}, v1::ROLE_UNSPECIFIED, 0};
  ++state_->counters.messages_received;
  for (const std::string& frame : message.frames) state_->counters.bytes_received += frame.size();
  if (message.payload) state_->counters.bytes_received += message.payload->size();
  if (state_->options.allow_list) {
    const auto entry = state_->options.allow_list->Find(message.user);
    if (!entry) {
      incoming.envelope = InvalidInput("this key is not in the coordinator's list of allowed keys (any more)");
      ++state_->counters.keys_refused;
      return incoming;
    }
    incoming.user = entry->name;
    incoming.role = entry->role;
  }
  if (message.frames.size() == kFrameCount) {
    incoming.bytes = message.frames.back().size();
    incoming.other_release = ReadHelloOfOtherProtocol(message.frames[1], message.frames[2], state_->options.limits);
  }
  incoming.envelope = DecodeMessage(std::move(message), kFrameCount, state_->options.limits, &incoming.payload);
  if (!incoming.envelope.ok()) ++state_->counters.garbage;
  return incoming;
}

bool RouterChannel::Send(const std::string& peer, const v1::Envelope& envelope, Payload payload) {
  const EnvelopeFrames frames = EncodeEnvelope(envelope);
  const std::size_t bytes = frames.header.size() + frames.body.size() + payload.size();
  try {
    const bool sent = SendNow(&state_->socket, &peer, frames, CarriesPayload(envelope) ? &payload : nullptr);
    state_->counters.messages_sent += sent ? 1 : 0;
    state_->counters.bytes_sent += sent ? bytes : 0;
    return sent;
  } catch (const zmq::error_t&) {
    return false;  // EHOSTUNREACH: the peer is gone.
  }
}

void RouterChannel::Wake() const { state_->wake.Notify(); }

ChannelCounters RouterChannel::counters() const {
  ChannelCounters counters = state_->counters;
  if (state_->authenticator) counters.keys_refused += state_->authenticator->refused_count();
  return counters;
}

}  // namespace trem
