#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "mosaic/base/status.h"
#include "proto/channel/payload.h"
#include "proto/channel/router_channel.h"
#include "proto/codec/envelope.h"

namespace trem {

// What a worker or client needs to talk to a coordinator with keys: its own .key file and the coordinator's .pub file. Both empty: no keys.
// Errors: one without the other, a file that is no such key, or a coordinator's key that has another role.
Result<ChannelOptions> ChannelOptionsOf(const std::filesystem::path& key, const std::filesystem::path& coordinator_key);

// A worker's or client's end (DEALER). Reconnects by itself. All calls but Wake belong to the thread that made it.
class DealerChannel {
 public:
  // `endpoint`: what RouterChannel::endpoint() says. Succeeds whether or not anybody listens there yet. Addresses other than ipc and IPv4
  // loopback need keys.
  static Result<std::unique_ptr<DealerChannel>> Connect(const std::string& endpoint, const ChannelOptions& options = {});
  ~DealerChannel();

  // kUnavailable when no connection stands within `timeout` (nothing is queued then). Ok means "on its way": a message can be lost when
  // the connection breaks; what matters is acknowledged and resent by the caller.
  Status Send(const v1::Envelope& envelope, std::chrono::milliseconds timeout = std::chrono::milliseconds(0), Payload payload = {});
  // The next message; nothing after `timeout`, a Wake or a signal. Errors as DecodeEnvelope and ValidatePayload; the channel stays usable.
  Result<std::optional<v1::Envelope>> Receive(std::chrono::milliseconds timeout);
  // The same, with the bytes that came beside it.
  Result<std::optional<v1::Envelope>> Receive(std::chrono::milliseconds timeout, Payload* payload);
  // Makes a running or the next Receive return. From any thread or signal handler.
  void Wake() const;
  // Messages that were not valid envelopes.
  std::uint64_t garbage_count() const;

 private:
  struct State;
  explicit DealerChannel(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace trem
