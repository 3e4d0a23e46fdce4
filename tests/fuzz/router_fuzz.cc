// Goal: no bytes on a coordinator's line harm it: the transport or the decoder refuses them, and the next peer is heard. Method: a
// RouterChannel on loopback; each input is what a connection says after ZeroMQ's greeting and handshake (or, when it begins with 'r',
// instead of them).
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include "mosaic/base/check.h"
#include "proto/channel/router_channel.h"
#include "tests/fuzz/connection.h"

namespace {

using namespace std::string_literals;
using std::chrono::milliseconds;

// ZMTP 3.0: signature, version, mechanism NULL, not a server, padding.
const std::string& Greeting() {
  static const std::string bytes = "\xff\0\0\0\0\0\0\0\x01\x7f\x03\0"s + "NULL" + std::string(16, '\0') + std::string(32, '\0');
  return bytes;
}

// The command READY of a DEALER.
const std::string& Ready() {
  static const std::string bytes = "\x04\x1c\x05READY\x0bSocket-Type\0\0\0\x06"s + "DEALER";
  return bytes;
}

std::unique_ptr<trem::RouterChannel> Bind() {
  auto channel = trem::RouterChannel::Bind("tcp://127.0.0.1:*");
  TREM_CHECK_MSG(channel.ok(), channel.status().ToString());
  return std::move(channel).value();
}

// Says the bytes and takes in what the channel makes of them.
bool Say(trem::RouterChannel* channel, const std::string& bytes, bool with_greeting, bool expect_message) {
  const int fd = trem::fuzz::ConnectTo(channel->endpoint());
  if (with_greeting) {
    // Whoever does not wait for the other's greeting is not listened to.
    (void)::send(fd, Greeting().data(), Greeting().size(), MSG_NOSIGNAL);
    std::string answer(Greeting().size(), '\0');
    (void)::recv(fd, answer.data(), answer.size(), MSG_WAITALL);
  }
  (void)::send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL);
  bool is_valid = false;
  // What earlier connections said may still be waiting; a signal ends a Poll early.
  for (int silences = 0; silences < (expect_message ? 5 : 1) && !(expect_message && is_valid);) {
    const auto incoming = channel->Poll(milliseconds(expect_message ? 1000 : 1));
    silences += incoming ? 0 : 1;
    if (!incoming || !incoming->envelope.ok()) continue;
    is_valid = true;
    channel->Send(incoming->peer, *incoming->envelope);
  }
  ::close(fd);
  return is_valid;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const std::unique_ptr<trem::RouterChannel> channel = Bind();
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  const bool is_raw = bytes.starts_with('r');
  Say(channel.get(), is_raw ? bytes.substr(1) : Ready() + bytes, !is_raw, false);
  static unsigned count = 0;
  if (++count % 256 == 0) {
    // A heartbeat in two frames: the header, and an empty message of field 40.
    const std::string heartbeat = Ready() + "\x01\x08TREM\x02\0\0\0"s + "\x00\x03\xc2\x02\x00"s;
    TREM_CHECK_MSG(Say(channel.get(), heartbeat, true, true), "a valid message is not heard any more");
  }
  return 0;
}
