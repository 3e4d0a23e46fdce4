#include "proto/channel/dealer_channel.h"

#include <cerrno>
#include <utility>

#include "proto/channel/socket.h"

namespace trem {

Result<ChannelOptions> ChannelOptionsOf(const std::filesystem::path& key, const std::filesystem::path& coordinator_key) {
  ChannelOptions options;
  if (key.empty() && coordinator_key.empty()) return options;
  if (key.empty() || coordinator_key.empty()) {
    return InvalidInput("--key (TREM_KEY) and --coordinator-key (TREM_COORDINATOR_KEY) belong together; only one of them was given");
  }
  TREM_ASSIGN_OR_RETURN(options.own_key, ReadSecretKey(key));
  TREM_ASSIGN_OR_RETURN(const v1::KeyFile coordinator, ReadPublicKey(coordinator_key));
  if (coordinator.role() != v1::COORDINATOR) {
    return InvalidInput(coordinator_key.string() + " has the role " + RoleName(coordinator.role()) +
                        "; expected the coordinator's .pub file");
  }
  options.coordinator_public_key = coordinator.public_key();
  return options;
}

struct DealerChannel::State {
  ChannelOptions options;
  std::string endpoint;
  WakeEvent wake;
  zmq::context_t context;
  zmq::socket_t socket{context, zmq::socket_type::dealer};
  std::uint64_t garbage_count = 0;
};

DealerChannel::DealerChannel(std::unique_ptr<State> state) : state_(std::move(state)) {}
DealerChannel::~DealerChannel() = default;

Result<std::unique_ptr<DealerChannel>> DealerChannel::Connect(const std::string& endpoint, const ChannelOptions& options) {
  TREM_RETURN_IF_ERROR(CheckDealer(endpoint, options));
  auto state = std::make_unique<State>();
  state->options = options;
  state->endpoint = endpoint;
  try {
    ConfigureSocket(&state->socket, endpoint, options);
    // Nothing is queued for a coordinator that is not there: what it would read later is out of date.
    state->socket.set(zmq::sockopt::immediate, true);
    state->socket.connect(endpoint);
  } catch (const zmq::error_t& error) {
    return InvalidInput("cannot connect to " + endpoint + ": " + error.what());
  }
  return std::unique_ptr<DealerChannel>(new DealerChannel(std::move(state)));
}

Status DealerChannel::Send(const v1::Envelope& envelope, std::chrono::milliseconds timeout, Payload payload) {
  const EnvelopeFrames frames = EncodeEnvelope(envelope);
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  for (;;) {
    try {
      if (SendNow(&state_->socket, nullptr, frames, CarriesPayload(envelope) ? &payload : nullptr)) return {};
    } catch (const zmq::error_t& error) {
      if (error.num() != EINTR) return Unavailable("cannot send to the coordinator at " + state_->endpoint + ": " + error.what());
    }
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
    if (left.count() <= 0) {
      return Unavailable(
          "no coordinator answers at " + state_->endpoint + "; start trem-coordinator there or name another endpoint" +
          (state_->options.own_key ? "; one that does not know this key, or has another key than the one named, is silent" : ""));
    }
    // A wake is for Receive: it must not end the wait for a connection, and must not be lost.
    zmq::pollitem_t item{state_->socket.handle(), 0, ZMQ_POLLOUT, 0};
    (void)zmq_poll(&item, 1, static_cast<long>(left.count()));
  }
}

Result<std::optional<v1::Envelope>> DealerChannel::Receive(std::chrono::milliseconds timeout) {
  Payload ignored;
  return Receive(timeout, &ignored);
}

Result<std::optional<v1::Envelope>> DealerChannel::Receive(std::chrono::milliseconds timeout, Payload* payload) {
  constexpr std::size_t kFrameCount = 2;  // Header, body.
  RawMessage message;
  if (!ReceiveNext(&state_->socket, state_->wake, timeout, kFrameCount, &message)) return std::optional<v1::Envelope>();
  Result<v1::Envelope> envelope = DecodeMessage(std::move(message), kFrameCount, state_->options.limits, payload);
  if (!envelope.ok()) {
    ++state_->garbage_count;
    return envelope.status();
  }
  return std::optional<v1::Envelope>(std::move(envelope).value());
}

void DealerChannel::Wake() const { state_->wake.Notify(); }

std::uint64_t DealerChannel::garbage_count() const { return state_->garbage_count; }

}  // namespace trem
