#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "mosaic/base/status.h"
#include "proto/codec/envelope.h"

namespace trem {

struct ChannelOptions {
  EnvelopeLimits limits;
  // How long closing may wait for queued messages to leave.
  std::chrono::milliseconds linger{500};
  // DealerChannel only: the name under which the coordinator sees this peer, the same after a reconnect. Empty: a fresh random name for
  // every connection. Workers use their worker id.
  std::string identity;
};

// The coordinator's end (ROUTER). All calls but Wake belong to the thread that made it.
class RouterChannel {
 public:
  struct Incoming {
    std::string peer;               // Identity for Send; binary, at most 255 bytes.
    Result<v1::Envelope> envelope;  // kInvalidInput: a peer of another protocol version; kCorrupt: garbage. Neither is fatal.
  };

  // Binds to ipc://PATH, tcp://127.x.y.z:PORT or tcp://127.x.y.z:* (any free port). Any other address is refused: it would need keys.
  static Result<std::unique_ptr<RouterChannel>> Bind(const std::string& endpoint, const ChannelOptions& options = {});
  ~RouterChannel();

  // The endpoint that peers connect to, with the real port.
  const std::string& endpoint() const;
  // The next message; nothing after `timeout`, a Wake or a signal. Messages are returned before wakes.
  std::optional<Incoming> Poll(std::chrono::milliseconds timeout);
  // False when the peer is gone or does not take what it was sent: the message is lost and the sender has to resend it in time.
  bool Send(const std::string& peer, const v1::Envelope& envelope);
  // Makes a running or the next Poll return. From any thread or signal handler.
  void Wake() const;
  // Messages that were not valid envelopes.
  std::uint64_t garbage_count() const;

 private:
  struct State;
  explicit RouterChannel(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace trem
