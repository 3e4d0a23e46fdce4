#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace trem {

// Key, length, value: SMPTE ST 336. Every length is checked against what is there and against these limits before anything is kept.
inline constexpr std::size_t kKlvKeyBytes = 16;
inline constexpr std::size_t kKlvPacketBytesMax = std::size_t{1} << 20;
inline constexpr std::size_t kKlvItemsMax = 1024;

using Bytes = std::span<const std::uint8_t>;

// A BER length (ST 336, 6.3.2): short form, or long form of 1 to 8 bytes. Nothing when it is cut short, indefinite (0x80) or longer.
struct BerLength {
  std::uint64_t value = 0;
  std::size_t bytes = 0;  // That it occupies.
};
std::optional<BerLength> ReadBerLength(Bytes bytes);

// A BER-OID tag (ST 336, 6.3.1) of 1 to 4 bytes. Nothing when it is cut short or longer.
std::optional<BerLength> ReadBerOid(Bytes bytes);

// Big-endian integer of 1 to 8 bytes.
std::uint64_t ReadUnsigned(Bytes bytes);
std::int64_t ReadSigned(Bytes bytes);

// One universal key with its value; views of the splitter's buffer, valid during the call.
struct KlvPacket {
  Bytes key;
  Bytes value;
  Bytes whole;  // Key, length and value: what checksums run over.
  std::optional<double> pts_s;
};

// Finds the KLV packets in a data stream that comes in pieces: one piece may hold several packets, headers before them (a metadata access
// unit's), or a part of one.
class KlvSplitter {
 public:
  explicit KlvSplitter(std::function<void(const KlvPacket&)> consume) : consume_(std::move(consume)) {}

  void Feed(Bytes piece, std::optional<double> pts_s);
  // A packet that is still incomplete is cut short.
  void Finish();

  std::int64_t impossible_lengths() const { return impossible_lengths_; }  // Longer than the limit, or no length at all.
  std::int64_t cut_short() const { return cut_short_; }
  const std::string& first_problem() const { return first_problem_; }  // In words; empty: none.

 private:
  void Scan();
  void Report(const std::string& what);

  std::function<void(const KlvPacket&)> consume_;
  std::vector<std::uint8_t> buffer_;
  std::optional<double> pts_s_;  // Of the piece in which the buffer's packet began.
  std::int64_t pieces_ = 0;
  std::int64_t impossible_lengths_ = 0;
  std::int64_t cut_short_ = 0;
  std::string first_problem_;
};

}  // namespace trem
