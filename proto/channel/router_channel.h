#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "mosaic/base/status.h"
#include "proto/channel/keys.h"
#include "proto/channel/payload.h"
#include "proto/codec/envelope.h"

namespace trem {

struct ChannelOptions {
  EnvelopeLimits limits;
  // How long closing may wait for queued messages to leave.
  std::chrono::milliseconds linger{500};
  // CURVE. With a key, addresses beyond this machine are possible, and nothing passes unencrypted or unauthenticated.
  std::optional<v1::KeyFile> own_key;           // With its secret half.
  std::string coordinator_public_key;           // DealerChannel, with own_key: Z85; nobody else is talked to.
  std::shared_ptr<const AllowList> allow_list;  // RouterChannel, with own_key: who is let in.
  // Messages of one peer that wait here to be read: what it sends beyond them waits at its end.
  int messages_unread_max = 256;
  // Messages that wait until one peer takes them; RouterChannel loses those beyond.
  int messages_unsent_max = 1000;
  // RouterChannel: further connections are closed as soon as they are accepted.
  int connections_max = 4096;
  // A connection that has not shaken hands (and shown its key) after this is closed.
  std::chrono::milliseconds handshake_timeout{5000};
};

// Totals since the socket was made.
struct ChannelCounters {
  std::uint64_t connections = 0;  // Standing now.
  std::uint64_t accepted = 0;
  std::uint64_t refused_full = 0;       // Closed because there were connections_max already.
  std::uint64_t handshakes_failed = 0;  // No key, an unknown key, another protocol, or too slow.
  std::uint64_t keys_refused = 0;       // Of these: an unknown key.
  std::uint64_t messages_received = 0;
  std::uint64_t messages_sent = 0;
  std::uint64_t bytes_received = 0;
  std::uint64_t bytes_sent = 0;
  std::uint64_t garbage = 0;  // Messages that were not valid envelopes.
};

// The coordinator's end (ROUTER). All calls but Wake belong to the thread that made it.
class RouterChannel {
 public:
  struct Incoming {
    std::string peer;               // Identity for Send; binary, at most 255 bytes. Another one for every connection.
    Result<v1::Envelope> envelope;  // kInvalidInput: a peer of another protocol version; kCorrupt: garbage. Neither is fatal.
    std::string user;               // Name of its key; empty without keys.
    // Of its key; unspecified without keys: whoever reaches the socket may do everything.
    v1::Role role = v1::ROLE_UNSPECIFIED;
    std::size_t bytes = 0;  // Of the body.
    Payload payload{};      // Of a PutChunk.
    // When `envelope` is refused because of its protocol version, and it was a worker's Hello: what that worker says of itself.
    std::optional<v1::Hello> other_release{};
  };

  // Binds to ipc://PATH (a socket that only this user can connect to), tcp://127.x.y.z:PORT or tcp://127.x.y.z:* (any free port), and
  // with keys to any address: tcp://*:PORT is all of them. With keys, a peer whose key is not in the allow-list is not let in, and one
  // whose key leaves the list later gets an error for every message (kInvalidInput in `envelope`).
  static Result<std::unique_ptr<RouterChannel>> Bind(const std::string& endpoint, const ChannelOptions& options = {});
  ~RouterChannel();

  // The endpoint that peers connect to, with the real port.
  const std::string& endpoint() const;
  // The next message; nothing after `timeout`, a Wake or a signal. Messages are returned before wakes.
  std::optional<Incoming> Poll(std::chrono::milliseconds timeout);
  // False when the peer is gone or does not take what it was sent: the message is lost and the sender has to resend it in time.
  bool Send(const std::string& peer, const v1::Envelope& envelope, Payload payload = {});
  // Makes a running or the next Poll return. From any thread or signal handler.
  void Wake() const;
  ChannelCounters counters() const;

 private:
  struct State;
  explicit RouterChannel(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace trem
