#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace trem::testing {

// Writes KLV packets, for tests, from the standards' formulas.
class KlvBuilder {
 public:
  using Packet = std::vector<std::uint8_t>;

  // An item of a local set: BER-OID tag, BER length, value.
  KlvBuilder& Item(int tag, const Packet& value);
  // The forward mapping of an unsigned or signed integer of `bytes` bytes.
  KlvBuilder& Unsigned(int tag, int bytes, double low, double high, double value);
  KlvBuilder& Signed(int tag, int bytes, double high, double value);
  KlvBuilder& Time(std::uint64_t utc_us);
  KlvBuilder& Text(int tag, const std::string& text);
  // An item of a universal set: the twelve bytes of its key after 06 0E 2B 34, as hexadecimal digits.
  KlvBuilder& Float(const std::string& key_end, double value, int bytes);
  KlvBuilder& Universal(const std::string& key_end, const Packet& value);

  // The whole packet. ST 0601 with its checksum as the last item, or without one.
  Packet St0601(bool checksum = true) const;
  Packet Eg0104() const;

  static Packet BigEndian(std::uint64_t value, int bytes);
  static Packet Hex(const std::string& digits);
  static void AppendLength(std::size_t length, Packet* packet);

 private:
  Packet body_;
};

}  // namespace trem::testing
