#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// One message of the control lane on the wire: two ZeroMQ frames.
//
//   header  8 bytes: "TREM", u16 protocol version, u16 flags (0); little endian
//   body    a serialised v1::Envelope
//
// On the data lane a third one holds the bytes of a chunk.
//
// The version stands outside the body, so that peers of any two versions can tell each other that they do not match.
struct EnvelopeFrames {
  std::string header;
  std::string body;
};

inline constexpr std::size_t kEnvelopeHeaderBytes = 8;

// Checked before anything is parsed or allocated.
struct EnvelopeLimits {
  std::size_t body_bytes_max = std::size_t{32} << 20;  // Raise when a job has more artefacts than fit; memory grows alike.
  int depth_max = 32;                                  // Levels of nested messages. The schemas need 6.
};

// Precondition: `envelope` passes ValidateEnvelope (a message of ours that does not is a bug).
EnvelopeFrames EncodeEnvelope(const v1::Envelope& envelope);
// Errors: kInvalidInput for a peer of another protocol version (the message names both versions); kCorrupt for all other garbage.
Result<v1::Envelope> DecodeEnvelope(std::string_view header, std::string_view body, const EnvelopeLimits& limits = {});

// What a worker of another protocol version said of itself, with that version, as far as this program can read it: enough to name the
// worker that was refused. Nullopt for whatever else DecodeEnvelope refuses, and for what it takes.
std::optional<v1::Hello> ReadHelloOfOtherProtocol(std::string_view header, std::string_view body, const EnvelopeLimits& limits = {});

// The one validator of what peers say: exactly one body; identifiers, digests, enumerations and numbers in range. DecodeEnvelope has
// applied it already. A Sortie inside is checked for its presence only: CompleteSortie checks its values. Errors are kCorrupt.
Status ValidateEnvelope(const v1::Envelope& envelope);

// Chunk and PutChunk travel with bytes beside them, in a third frame.
bool CarriesPayload(const v1::Envelope& envelope);
// Whether the third frame, of so many bytes or missing, is what belongs to a valid envelope. Errors are kCorrupt.
Status ValidatePayload(const v1::Envelope& envelope, std::optional<std::size_t> bytes);

// [a-z0-9-]{1,64}.
bool IsJobId(std::string_view text);
// [a-z0-9-]{1,128}.
bool IsWorkerId(std::string_view text);

}  // namespace trem
