// Feeds arbitrary bytes to the envelope decoder: the first 8 as the header, or all as the body behind a valid header. What is accepted
// must be encodable again and decode to the same bytes.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "mosaic/base/check.h"
#include "proto/codec/envelope.h"

namespace {

void Decode(std::string_view header, std::string_view body) {
  const auto decoded = trem::DecodeEnvelope(header, body);
  const auto other = trem::ReadHelloOfOtherProtocol(header, body);
  TREM_CHECK(!other || (!decoded.ok() && trem::IsWorkerId(other->worker_id())));
  if (!decoded.ok()) return;
  const bool fits = trem::ValidatePayload(*decoded, body.size()).ok();
  TREM_CHECK(!fits || (trem::CarriesPayload(*decoded) && !trem::ValidatePayload(*decoded, std::nullopt).ok()));
  const trem::EnvelopeFrames frames = trem::EncodeEnvelope(*decoded);
  const auto again = trem::DecodeEnvelope(frames.header, frames.body);
  TREM_CHECK(again.ok() && trem::EncodeEnvelope(*again).body == frames.body);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  Decode(bytes.substr(0, trem::kEnvelopeHeaderBytes), bytes.substr(std::min(size, trem::kEnvelopeHeaderBytes)));
  Decode(std::string_view("TREM\x02\0\0\0", 8), bytes);
  Decode(std::string_view("TREM\x01\0\0\0", 8), bytes);
  return 0;
}
