#include "worker/telemetry/klv_packets.h"

#include <algorithm>

#include "mosaic/base/check.h"

namespace trem {
namespace {

// Every universal key begins so (ST 336, 6.2).
constexpr std::array<std::uint8_t, 4> kKeyStart = {0x06, 0x0e, 0x2b, 0x34};

// ISO 13818-1, 2.12.4.
constexpr std::size_t kAccessUnitHeaderBytes = 5;

bool StartsWithKey(Bytes bytes) {
  return bytes.size() >= kKeyStart.size() && std::equal(kKeyStart.begin(), kKeyStart.end(), bytes.begin());
}

}  // namespace

std::optional<BerLength> ReadBerLength(Bytes bytes) {
  if (bytes.empty()) return std::nullopt;
  if (bytes[0] < 0x80) return BerLength{bytes[0], 1};
  const std::size_t count = bytes[0] & 0x7fU;
  if (count == 0 || count > 8 || bytes.size() < count + 1) return std::nullopt;
  return BerLength{ReadUnsigned(bytes.subspan(1, count)), count + 1};
}

std::optional<BerLength> ReadBerOid(Bytes bytes) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < std::min<std::size_t>(4, bytes.size()); ++i) {
    value = (value << 7U) | (bytes[i] & 0x7fU);
    if (bytes[i] < 0x80) return BerLength{value, i + 1};
  }
  return std::nullopt;
}

std::uint64_t ReadUnsigned(Bytes bytes) {
  TREM_CHECK(!bytes.empty() && bytes.size() <= 8);
  std::uint64_t value = 0;
  for (const std::uint8_t byte : bytes) value = (value << 8U) | byte;
  return value;
}

std::int64_t ReadSigned(Bytes bytes) {
  const unsigned unused_bits = static_cast<unsigned>(64 - 8 * bytes.size());
  // The arithmetic shift back carries the sign down.
  return static_cast<std::int64_t>(ReadUnsigned(bytes) << unused_bits) >> unused_bits;
}

void KlvSplitter::Report(const std::string& what) {
  if (first_problem_.empty()) first_problem_ = "data packet " + std::to_string(pieces_ - 1) + ": " + what;
}

void KlvSplitter::Feed(Bytes piece, std::optional<double> pts_s) {
  ++pieces_;
  // A piece that begins with a key, or with a metadata access unit's header and a key, begins a packet: what is still waiting will not be
  // continued.
  const bool begins =
      StartsWithKey(piece) || (piece.size() > kAccessUnitHeaderBytes && StartsWithKey(piece.subspan(kAccessUnitHeaderBytes)));
  if (!buffer_.empty() && begins) Finish();
  if (buffer_.empty()) pts_s_ = pts_s;
  buffer_.insert(buffer_.end(), piece.begin(), piece.end());
  Scan();
  if (buffer_.size() > kKlvPacketBytesMax + 64) Finish();
}

void KlvSplitter::Finish() {
  if (buffer_.size() >= kKeyStart.size()) {
    ++cut_short_;
    Report("ends " + std::to_string(buffer_.size()) + " bytes after a key, before the packet that it begins");
  }
  buffer_.clear();
}

void KlvSplitter::Scan() {
  std::size_t position = 0;
  while (true) {
    const auto found =
        std::search(buffer_.begin() + static_cast<std::ptrdiff_t>(position), buffer_.end(), kKeyStart.begin(), kKeyStart.end());
    position = static_cast<std::size_t>(found - buffer_.begin());
    const Bytes rest = Bytes(buffer_).subspan(position);
    if (rest.empty()) break;
    if (rest.size() <= kKlvKeyBytes) break;  // Wait for more.
    const std::optional<BerLength> length = ReadBerLength(rest.subspan(kKlvKeyBytes));
    const bool may_continue = !length.has_value() && rest[kKlvKeyBytes] > 0x80 && rest[kKlvKeyBytes] <= 0x88;
    if (may_continue) break;
    if (!length.has_value() || length->value > kKlvPacketBytesMax) {
      ++impossible_lengths_;
      Report("its length is " +
             (length.has_value() ? std::to_string(length->value) + " bytes" : std::string("indefinite or of more than 8 bytes")) +
             "; expected at most " + std::to_string(kKlvPacketBytesMax));
      position += kKeyStart.size();
      continue;
    }
    const std::size_t header = kKlvKeyBytes + length->bytes;
    const std::size_t size = header + static_cast<std::size_t>(length->value);
    if (rest.size() < size) break;
    consume_({rest.first(kKlvKeyBytes), rest.subspan(header, size - header), rest.first(size), pts_s_});
    position += size;
  }
  buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(position));
}

}  // namespace trem
