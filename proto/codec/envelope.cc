#include "proto/codec/envelope.h"

#include <fmt/format.h>
#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/stubs/logging.h>

#include <algorithm>
#include <limits>

#include "mosaic/base/version.h"
#include "proto/codec/convert.h"

namespace trem {
namespace {

constexpr std::string_view kMagic = "TREM";

unsigned ReadU16(std::string_view bytes, std::size_t at) {
  return static_cast<unsigned char>(bytes[at]) | static_cast<unsigned>(static_cast<unsigned char>(bytes[at + 1])) << 8;
}

bool IsHeader(std::string_view header) { return header.size() == kEnvelopeHeaderBytes && header.starts_with(kMagic); }

Status CheckHeader(std::string_view header) {
  if (!IsHeader(header)) {
    return Corrupt(fmt::format("a message whose header is not trem's ({} bytes; expected {} that start with TREM)", header.size(),
                               kEnvelopeHeaderBytes));
  }
  const unsigned version = ReadU16(header, 4);
  if (version != kProtocolVersion) {
    return InvalidInput(
        fmt::format("the peer speaks protocol version {}, this program version {}; install the same release of trem on both sides", version,
                    kProtocolVersion));
  }
  if (const unsigned flags = ReadU16(header, 6); flags != 0) return Corrupt(fmt::format("message header with unknown flags {:#x}", flags));
  return {};
}

// Protobuf would tell stderr of every message with a text that is no UTF-8: whoever sends garbage could fill the log with it. That it was
// garbage is in the Status.
void SilenceProtobuf() {
  static const auto before = google::protobuf::SetLogHandler(nullptr);
  (void)before;
}

Result<v1::Envelope> ParseBody(std::string_view body, const EnvelopeLimits& limits) {
  SilenceProtobuf();
  const std::size_t bytes_max = std::min<std::size_t>(limits.body_bytes_max, std::numeric_limits<int>::max());
  if (body.size() > bytes_max) return Corrupt(fmt::format("a message of {} bytes; at most {} are accepted", body.size(), bytes_max));
  google::protobuf::io::CodedInputStream stream(reinterpret_cast<const std::uint8_t*>(body.data()), static_cast<int>(body.size()));
  stream.SetRecursionLimit(limits.depth_max);
  v1::Envelope envelope;
  if (!envelope.ParseFromCodedStream(&stream) || !stream.ConsumedEntireMessage()) {
    return Corrupt(fmt::format("a message of {} bytes that is not a trem.v1.Envelope or is nested deeper than {} levels", body.size(),
                               limits.depth_max));
  }
  TREM_RETURN_IF_ERROR(ValidateEnvelope(envelope));
  return envelope;
}

}  // namespace

EnvelopeFrames EncodeEnvelope(const v1::Envelope& envelope) {
  const Status status = ValidateEnvelope(envelope);
  TREM_CHECK_MSG(status.ok(), status.message());
  static_assert(kProtocolVersion <= 0xffff);
  EnvelopeFrames frames;
  frames.header = kMagic;
  frames.header += {static_cast<char>(kProtocolVersion & 0xff), static_cast<char>(kProtocolVersion >> 8), '\0', '\0'};
  frames.body = SerializeDeterministic(envelope);
  return frames;
}

Result<v1::Envelope> DecodeEnvelope(std::string_view header, std::string_view body, const EnvelopeLimits& limits) {
  TREM_RETURN_IF_ERROR(CheckHeader(header));
  return ParseBody(body, limits);
}

std::optional<v1::Hello> ReadHelloOfOtherProtocol(std::string_view header, std::string_view body, const EnvelopeLimits& limits) {
  if (!IsHeader(header) || ReadU16(header, 4) == kProtocolVersion) return std::nullopt;
  Result<v1::Envelope> envelope = ParseBody(body, limits);
  if (!envelope.ok() || !envelope->has_hello()) return std::nullopt;
  envelope->mutable_hello()->set_protocol_version(ReadU16(header, 4));
  return std::move(*envelope->mutable_hello());
}

}  // namespace trem
