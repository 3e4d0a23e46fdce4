#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <variant>

#include "worker/telemetry/klv_packets.h"
#include "worker/telemetry/telemetry_record.h"

namespace trem {

// Physical values of a set's items by tag. Numbers are in the standard's units (degrees, metres, metres a second; tag 2: microseconds).
using KlvNumbers = std::map<int, double>;
using KlvTexts = std::map<int, std::string>;

struct KlvSet {
  KlvNumbers numbers;
  KlvTexts texts;
  std::optional<std::uint64_t> utc_us;  // The precision time stamp, exact.
  int error_values = 0;                 // Items that hold the reserved "out of range" or "error" value: absent.
  int ill_formed = 0;                   // Items of a length that their tag does not allow, or out of their physical range: absent.
  std::string first_problem;
};

enum class KlvVerdict {
  kGood,
  kOtherKey,         // No set that is read here.
  kBadChecksum,      // Not a byte of it is used.
  kImpossibleItems,  // An item runs over the end of the set, or there are more than kKlvItemsMax: not used.
};

// ST 0601 (UAS Datalink Local Set): the tags that say where the camera is and what it sees, among them all full-range ones and those in
// IMAPB (ST 1201). Mapped integers as ST 0601.16, clause 8: unsigned over [low, high]; signed over [-high, high] in steps of
// high / (2^(n-1) - 1), -2^(n-1) reserved. The checksum (tag 1: sum of 16-bit words over the whole packet up to the checksum's value) is
// verified where there is one.
KlvVerdict ReadSt0601(const KlvPacket& packet, KlvSet* set);
bool IsSt0601(Bytes key);
// Whether the set carried a checksum.
bool HasChecksum(const KlvSet& set);

// EG 0104 (Predator Basic Universal Metadata Set): universal keys with IEEE floating point values. Its items get the tags of their
// ST 0601 successors, except kKlvAngleToNorth and kKlvObliquity.
KlvVerdict ReadEg0104(const KlvPacket& packet, KlvSet* set);
bool IsEg0104(Bytes key);

// Items of EG 0104 that ST 0601 has no tag for: 06 0E 2B 34 01 01 01 01 07 01 10 01 02 00 00 00 and ... 03 00 00 00.
inline constexpr int kKlvAngleToNorth = 1002;
inline constexpr int kKlvObliquity = 1003;

// Reverse mapping of IMAPB(low, high, bytes) (ST 1201.4, clause 8): nothing for the special values (infinities, NaN, beyond the range).
std::optional<double> ReadImapb(Bytes bytes, double low, double high);

// The record that a set stands for; time_s is left at 0.
TelemetryRecord RecordFromKlv(const KlvSet& set);

}  // namespace trem
