#include "tests/unit/worker/telemetry/klv_builder.h"

#include <bit>
#include <cmath>

namespace trem::testing {
namespace {

void Append(const KlvBuilder::Packet& more, KlvBuilder::Packet* packet) { packet->insert(packet->end(), more.begin(), more.end()); }

}  // namespace

KlvBuilder::Packet KlvBuilder::BigEndian(std::uint64_t value, int bytes) {
  Packet packet;
  for (int i = bytes - 1; i >= 0; --i) packet.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  return packet;
}

KlvBuilder::Packet KlvBuilder::Hex(const std::string& digits) {
  Packet packet;
  for (std::size_t i = 0; i + 1 < digits.size(); i += 2)
    packet.push_back(static_cast<std::uint8_t>(std::stoi(digits.substr(i, 2), nullptr, 16)));
  return packet;
}

void KlvBuilder::AppendLength(std::size_t length, Packet* packet) {
  if (length < 128) {
    packet->push_back(static_cast<std::uint8_t>(length));
  } else {
    packet->push_back(0x82);
    Append(BigEndian(length, 2), packet);
  }
}

KlvBuilder& KlvBuilder::Item(int tag, const Packet& value) {
  if (tag >= 128) body_.push_back(static_cast<std::uint8_t>(0x80 | (tag >> 7)));
  body_.push_back(static_cast<std::uint8_t>(tag & 0x7f));
  AppendLength(value.size(), &body_);
  Append(value, &body_);
  return *this;
}

KlvBuilder& KlvBuilder::Unsigned(int tag, int bytes, double low, double high, double value) {
  const double steps = std::exp2(8.0 * bytes) - 1.0;
  return Item(tag, BigEndian(static_cast<std::uint64_t>(std::llround((value - low) / (high - low) * steps)), bytes));
}

KlvBuilder& KlvBuilder::Signed(int tag, int bytes, double high, double value) {
  const double steps = std::exp2(8.0 * bytes - 1.0) - 1.0;
  return Item(tag, BigEndian(static_cast<std::uint64_t>(std::llround(value / high * steps)), bytes));
}

KlvBuilder& KlvBuilder::Time(std::uint64_t utc_us) { return Item(2, BigEndian(utc_us, 8)); }
KlvBuilder& KlvBuilder::Text(int tag, const std::string& text) { return Item(tag, Packet(text.begin(), text.end())); }

KlvBuilder& KlvBuilder::Universal(const std::string& key_end, const Packet& value) {
  Append(Hex("060e2b34" + key_end), &body_);
  AppendLength(value.size(), &body_);
  Append(value, &body_);
  return *this;
}

KlvBuilder& KlvBuilder::Float(const std::string& key_end, double value, int bytes) {
  return Universal(key_end, bytes == 4 ? BigEndian(std::bit_cast<std::uint32_t>(static_cast<float>(value)), 4)
                                       : BigEndian(std::bit_cast<std::uint64_t>(value), 8));
}

KlvBuilder::Packet KlvBuilder::St0601(bool checksum) const {
  Packet packet = Hex("060e2b34020b01010e01030101000000");
  AppendLength(body_.size() + (checksum ? 4 : 0), &packet);
  Append(body_, &packet);
  if (!checksum) return packet;
  packet.push_back(1);
  packet.push_back(2);
  // As in ST 0601.16, 6.3: the sum of big-endian 16-bit words, an odd last byte being a high one.
  std::uint32_t sum = 0;
  for (std::size_t i = 0; i < packet.size(); i += 2) sum += 256U * packet[i] + (i + 1 < packet.size() ? packet[i + 1] : 0U);
  Append(BigEndian(sum & 0xffffU, 2), &packet);
  return packet;
}

KlvBuilder::Packet KlvBuilder::Eg0104() const {
  Packet packet = Hex("060e2b34020101010e01010201010000");
  AppendLength(body_.size(), &packet);
  Append(body_, &packet);
  return packet;
}

}  // namespace trem::testing
