#pragma once

#include <chrono>
#include <string>

#include "proto/channel/router_channel.h"

namespace trem {

// What becomes of an attempt to connect to a coordinator.
enum class Reach {
  kReady,          // Hands were shaken: whatever is wrong lies beyond the connection.
  kNobodyListens,  // The machine refuses: no program has this port or socket.
  kNoWay,          // Nothing comes back: the host's name, the network or a firewall.
  kKeyNotAllowed,  // The coordinator does not let this key in.
  // Hung up on before hands were shaken: another key than the one named as the coordinator's, no such protocol at all, or full. Also keys
  // on one side only, when the other side hung up before its greeting could be read.
  kOtherKey,
  kKeysDiffer,  // One side uses keys and the other does not, as its greeting says.
};

// Connects, waits for the end of the handshake, `patience` at most, and hangs up. Errors as DealerChannel::Connect. A DealerChannel does
// the same without end and says nothing of it; this is for finding out why.
Result<Reach> ProbeConnection(const std::string& endpoint, const ChannelOptions& options, std::chrono::milliseconds patience);

}  // namespace trem
