#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>
#include <zmq.hpp>

#include "mosaic/base/status.h"
#include "proto/channel/payload.h"
#include "proto/channel/router_channel.h"
#include "proto/channel/wake_event.h"

namespace trem {

// What the two channels have in common; adapts libzmq's exceptions.

// Ok for ipc://PATH and tcp://127.x.y.z:PORT (or :* where `wildcard_port`), and with keys for tcp://HOST:PORT with any address, name or
// [IPv6 address], where * is all of this machine's if `wildcard_port`; otherwise kInvalidInput, with the reason.
Status CheckEndpoint(const std::string& endpoint, bool wildcard_port, bool has_keys);

// CheckEndpoint for an end that connects; with keys it has to know the other's, too.
Status CheckDealer(const std::string& endpoint, const ChannelOptions& options);

// Sets the options that every socket of ours has; throws zmq::error_t.
void ConfigureSocket(zmq::socket_t* socket, const std::string& endpoint, const ChannelOptions& options);

// Waits until the socket is ready for `events` (ZMQ_POLLIN or ZMQ_POLLOUT); false after `timeout`, a wake (which it clears) or a signal.
bool WaitFor(zmq::socket_t* socket, const WakeEvent& wake, short events, std::chrono::milliseconds timeout);

// Receives every frame of one message that is there already; keeps the first `frames_max` and, as it is, one more. Sets `is_complete` to
// whether that was all.
struct RawMessage {
  std::vector<std::string> frames;
  std::optional<zmq::message_t> payload;
  bool is_complete = true;
  std::string user;  // What the authenticator called the sender; empty without keys.
};
// False when no message is there.
bool ReceiveNow(zmq::socket_t* socket, std::size_t frames_max, RawMessage* message);

// The same, waiting where none is there: false after `timeout`, a wake or a signal.
bool ReceiveNext(zmq::socket_t* socket, const WakeEvent& wake, std::chrono::milliseconds timeout, std::size_t frames_max,
                 RawMessage* message);

// The envelope in the last two of `frame_count` frames. Its payload, where it is of a kind that has one, becomes `*payload`. Errors: as
// DecodeEnvelope and ValidatePayload; kCorrupt for other numbers of frames.
Result<v1::Envelope> DecodeMessage(RawMessage message, std::size_t frame_count, const EnvelopeLimits& limits, Payload* payload);

// Sends without waiting: the peer's name where there is one, header, body, and the payload unless it is null. False when the first of them
// is not taken; once it is, the others are. Throws zmq::error_t.
bool SendNow(zmq::socket_t* socket, const std::string* peer, const EnvelopeFrames& frames, Payload* payload);

}  // namespace trem
