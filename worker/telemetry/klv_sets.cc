#include "worker/telemetry/klv_sets.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

namespace trem {
namespace {

constexpr int kChecksumTag = 1;
constexpr int kTimeTag = 2;

constexpr std::array<std::uint8_t, 16> kSt0601Key = {0x06, 0x0e, 0x2b, 0x34, 0x02, 0x0b, 0x01, 0x01,
                                                     0x0e, 0x01, 0x03, 0x01, 0x01, 0x00, 0x00, 0x00};
constexpr std::array<std::uint8_t, 16> kEg0104Key = {0x06, 0x0e, 0x2b, 0x34, 0x02, 0x01, 0x01, 0x01,
                                                     0x0e, 0x01, 0x01, 0x02, 0x01, 0x01, 0x00, 0x00};

enum class Coding { kTime, kText, kUnsigned, kSigned, kImapb, kCount };

struct Item {
  int tag;
  Coding coding;
  std::size_t bytes;  // Exact; 0: 1 to 8 (IMAPB, counts) or any up to 127 (text).
  double low;
  double high;
};

// ST 0601.16, clause 8.
constexpr Item kItems[] = {
    {1, Coding::kCount, 2, 0, 0},             // Checksum.
    {2, Coding::kTime, 8, 0, 0},              // Precision time stamp.
    {3, Coding::kText, 0, 0, 0},              // Mission.
    {4, Coding::kText, 0, 0, 0},              // Platform tail number.
    {5, Coding::kUnsigned, 2, 0, 360},        // Platform heading.
    {6, Coding::kSigned, 2, -20, 20},         // Platform pitch.
    {7, Coding::kSigned, 2, -50, 50},         // Platform roll.
    {8, Coding::kUnsigned, 1, 0, 255},        // True airspeed.
    {10, Coding::kText, 0, 0, 0},             // Platform designation.
    {11, Coding::kText, 0, 0, 0},             // Image source sensor.
    {12, Coding::kText, 0, 0, 0},             // Image coordinate system.
    {13, Coding::kSigned, 4, -90, 90},        // Sensor latitude.
    {14, Coding::kSigned, 4, -180, 180},      // Sensor longitude.
    {15, Coding::kUnsigned, 2, -900, 19000},  // Sensor altitude, MSL.
    {16, Coding::kUnsigned, 2, 0, 180},       // Horizontal field of view.
    {17, Coding::kUnsigned, 2, 0, 180},       // Vertical field of view.
    {18, Coding::kUnsigned, 4, 0, 360},       // Sensor relative azimuth.
    {19, Coding::kSigned, 4, -180, 180},      // Sensor relative elevation.
    {20, Coding::kUnsigned, 4, 0, 360},       // Sensor relative roll.
    {21, Coding::kUnsigned, 4, 0, 5000000},   // Slant range.
    {22, Coding::kUnsigned, 2, 0, 10000},     // Target width.
    {23, Coding::kSigned, 4, -90, 90},        // Frame centre latitude.
    {24, Coding::kSigned, 4, -180, 180},      // Frame centre longitude.
    {25, Coding::kUnsigned, 2, -900, 19000},  // Frame centre elevation, MSL.
    {26, Coding::kSigned, 2, -0.075, 0.075},  // Corner offsets from the frame centre, latitude and longitude, 1 to 4.
    {27, Coding::kSigned, 2, -0.075, 0.075},  //
    {28, Coding::kSigned, 2, -0.075, 0.075},  //
    {29, Coding::kSigned, 2, -0.075, 0.075},  //
    {30, Coding::kSigned, 2, -0.075, 0.075},  //
    {31, Coding::kSigned, 2, -0.075, 0.075},  //
    {32, Coding::kSigned, 2, -0.075, 0.075},  //
    {33, Coding::kSigned, 2, -0.075, 0.075},  //
    {50, Coding::kSigned, 2, -20, 20},        // Platform angle of attack.
    {52, Coding::kSigned, 2, -20, 20},        // Platform sideslip.
    {56, Coding::kUnsigned, 1, 0, 255},       // Platform ground speed.
    {57, Coding::kUnsigned, 4, 0, 5000000},   // Ground range.
    {59, Coding::kText, 0, 0, 0},             // Platform call sign.
    {64, Coding::kUnsigned, 2, 0, 360},       // Platform magnetic heading.
    {65, Coding::kCount, 1, 0, 0},            // Version of ST 0601.
    {75, Coding::kUnsigned, 2, -900, 19000},  // Sensor height above the ellipsoid.
    {78, Coding::kUnsigned, 2, -900, 19000},  // Frame centre height above the ellipsoid.
    {79, Coding::kSigned, 2, -327, 327},      // Sensor velocity, north.
    {80, Coding::kSigned, 2, -327, 327},      // Sensor velocity, east.
    {82, Coding::kSigned, 4, -90, 90},        // Corner latitude and longitude, full, 1 to 4.
    {83, Coding::kSigned, 4, -180, 180},      //
    {84, Coding::kSigned, 4, -90, 90},        //
    {85, Coding::kSigned, 4, -180, 180},      //
    {86, Coding::kSigned, 4, -90, 90},        //
    {87, Coding::kSigned, 4, -180, 180},      //
    {88, Coding::kSigned, 4, -90, 90},        //
    {89, Coding::kSigned, 4, -180, 180},      //
    {90, Coding::kSigned, 4, -90, 90},        // Platform pitch, full.
    {91, Coding::kSigned, 4, -90, 90},        // Platform roll, full.
    {92, Coding::kSigned, 4, -90, 90},        // Platform angle of attack, full.
    {93, Coding::kSigned, 4, -180, 180},      // Platform sideslip, full.
    {96, Coding::kImapb, 0, 0, 1500000},      // Target width, extended.
    {103, Coding::kImapb, 0, -900, 40000},    // Density altitude, extended.
    {104, Coding::kImapb, 0, -900, 40000},    // Sensor height above the ellipsoid, extended.
    {112, Coding::kImapb, 0, 0, 360},         // Platform course.
    {113, Coding::kImapb, 0, -900, 40000},    // Altitude above ground.
    {114, Coding::kImapb, 0, -900, 40000},    // Radar altimeter.
    {117, Coding::kImapb, 0, -1000, 1000},    // Sensor azimuth rate.
    {118, Coding::kImapb, 0, -1000, 1000},    // Sensor elevation rate.
    {119, Coding::kImapb, 0, -1000, 1000},    // Sensor roll rate.
    {134, Coding::kImapb, 0, 0, 100},         // Zoom.
};

// EG 0104.5: bytes 5 to 16 of the key (all begin with 06 0E 2B 34), the tag of its successor, and the range of sensible values.
struct UniversalItem {
  std::array<std::uint8_t, 12> key;
  int tag;
  Coding coding;
  double low;
  double high;
};

constexpr UniversalItem kUniversalItems[] = {
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x02, 0x01, 0x01, 0x01, 0x05, 0x00, 0x00}, 2, Coding::kTime, 0, 0},
    {{0x01, 0x01, 0x01, 0x07, 0x07, 0x01, 0x10, 0x01, 0x06, 0x00, 0x00, 0x00}, 5, Coding::kSigned, -360, 360},
    {{0x01, 0x01, 0x01, 0x07, 0x07, 0x01, 0x10, 0x01, 0x05, 0x00, 0x00, 0x00}, 6, Coding::kSigned, -90, 90},
    {{0x01, 0x01, 0x01, 0x07, 0x07, 0x01, 0x10, 0x01, 0x04, 0x00, 0x00, 0x00}, 7, Coding::kSigned, -180, 180},
    {{0x01, 0x01, 0x01, 0x01, 0x01, 0x01, 0x20, 0x01, 0x00, 0x00, 0x00, 0x00}, 10, Coding::kText, 0, 0},
    {{0x01, 0x01, 0x01, 0x01, 0x04, 0x20, 0x01, 0x02, 0x01, 0x01, 0x00, 0x00}, 11, Coding::kText, 0, 0},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x01, 0x01, 0x00, 0x00, 0x00, 0x00}, 12, Coding::kText, 0, 0},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x02, 0x04, 0x02, 0x00}, 13, Coding::kSigned, -90, 90},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x02, 0x06, 0x02, 0x00}, 14, Coding::kSigned, -180, 180},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x02, 0x01, 0x02, 0x02, 0x00, 0x00}, 15, Coding::kSigned, -1000, 100000},
    {{0x01, 0x01, 0x01, 0x02, 0x04, 0x20, 0x02, 0x01, 0x01, 0x08, 0x00, 0x00}, 16, Coding::kSigned, 0, 180},
    {{0x01, 0x01, 0x01, 0x07, 0x04, 0x20, 0x02, 0x01, 0x01, 0x0a, 0x01, 0x00}, 17, Coding::kSigned, 0, 180},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x10, 0x01, 0x01, 0x00, 0x00, 0x00}, 20, Coding::kSigned, -360, 360},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x08, 0x01, 0x01, 0x00, 0x00, 0x00}, 21, Coding::kSigned, 0, 5000000},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x09, 0x02, 0x01, 0x00, 0x00, 0x00}, 22, Coding::kSigned, 0, 1500000},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x02, 0x01, 0x03, 0x02, 0x00, 0x00}, 23, Coding::kSigned, -90, 90},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x02, 0x01, 0x03, 0x04, 0x00, 0x00}, 24, Coding::kSigned, -180, 180},
    {{0x01, 0x01, 0x01, 0x0a, 0x07, 0x01, 0x02, 0x01, 0x03, 0x16, 0x00, 0x00}, 25, Coding::kSigned, -1000, 10000},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x03, 0x07, 0x01, 0x00}, 82, Coding::kSigned, -90, 90},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x03, 0x0b, 0x01, 0x00}, 83, Coding::kSigned, -180, 180},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x03, 0x08, 0x01, 0x00}, 84, Coding::kSigned, -90, 90},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x03, 0x0c, 0x01, 0x00}, 85, Coding::kSigned, -180, 180},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x03, 0x09, 0x01, 0x00}, 86, Coding::kSigned, -90, 90},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x03, 0x0d, 0x01, 0x00}, 87, Coding::kSigned, -180, 180},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x03, 0x0a, 0x01, 0x00}, 88, Coding::kSigned, -90, 90},
    {{0x01, 0x01, 0x01, 0x03, 0x07, 0x01, 0x02, 0x01, 0x03, 0x0e, 0x01, 0x00}, 89, Coding::kSigned, -180, 180},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x10, 0x01, 0x02, 0x00, 0x00, 0x00}, kKlvAngleToNorth, Coding::kSigned, -360, 360},
    {{0x01, 0x01, 0x01, 0x01, 0x07, 0x01, 0x10, 0x01, 0x03, 0x00, 0x00, 0x00}, kKlvObliquity, Coding::kSigned, -360, 360},
};

void Problem(KlvSet* set, int tag, const std::string& what) {
  ++set->ill_formed;
  if (set->first_problem.empty()) set->first_problem = "tag " + std::to_string(tag) + " " + what;
}

std::string TextOf(Bytes value) {
  std::string text(value.begin(), value.end());
  while (!text.empty() && text.back() == '\0') text.pop_back();
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  }
  return text;
}

bool FitsLength(const Item& item, std::size_t bytes) {
  if (item.coding == Coding::kText) return bytes <= 127;
  if (item.bytes != 0) return bytes == item.bytes;
  return bytes >= 1 && bytes <= 8;
}

void Decode(const Item& item, Bytes value, KlvSet* set) {
  // No length: the standard's way to say that a value is not known.
  if (value.empty()) return;
  if (!FitsLength(item, value.size())) {
    const std::string expected = item.bytes != 0 ? std::to_string(item.bytes) : item.coding == Coding::kText ? "at most 127" : "1 to 8";
    return Problem(set, item.tag, "has " + std::to_string(value.size()) + " bytes; expected " + expected);
  }
  switch (item.coding) {
    case Coding::kTime:
      set->utc_us = ReadUnsigned(value);
      set->numbers[item.tag] = static_cast<double>(*set->utc_us);
      return;
    case Coding::kText:
      set->texts[item.tag] = TextOf(value);
      return;
    case Coding::kCount:
      set->numbers[item.tag] = static_cast<double>(ReadUnsigned(value));
      return;
    case Coding::kUnsigned: {
      const double steps = std::exp2(8.0 * static_cast<double>(value.size())) - 1.0;
      set->numbers[item.tag] = item.low + (item.high - item.low) / steps * static_cast<double>(ReadUnsigned(value));
      return;
    }
    case Coding::kSigned: {
      const double reserved = -std::exp2(8.0 * static_cast<double>(value.size()) - 1.0);
      const auto number = static_cast<double>(ReadSigned(value));
      if (number == reserved) {
        ++set->error_values;
      } else {
        set->numbers[item.tag] = item.high / (-reserved - 1.0) * number;
      }
      return;
    }
    case Coding::kImapb: {
      const std::optional<double> number = ReadImapb(value, item.low, item.high);
      if (number.has_value()) {
        set->numbers[item.tag] = *number;
      } else {
        ++set->error_values;
      }
      return;
    }
  }
}

// ST 0601.16, 6.3: 16-bit sum of the bytes, taken by turns as high and low ones, up to the checksum's value.
std::uint16_t Checksum(Bytes bytes) {
  std::uint32_t sum = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) sum += static_cast<std::uint32_t>(bytes[i]) << (i % 2 == 0 ? 8U : 0U);
  return static_cast<std::uint16_t>(sum);
}

void DecodeFloat(const UniversalItem& item, Bytes value, KlvSet* set) {
  if (value.empty()) return;
  double number = 0.0;
  if (value.size() == 4) {
    number = static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(ReadUnsigned(value))));
  } else if (value.size() == 8) {
    number = std::bit_cast<double>(ReadUnsigned(value));
  } else {
    return Problem(set, item.tag, "has " + std::to_string(value.size()) + " bytes; expected 4 or 8");
  }
  if (!(number >= item.low && number <= item.high)) {
    return Problem(set, item.tag,
                   "is " + std::to_string(number) + "; expected " + std::to_string(item.low) + ".." + std::to_string(item.high));
  }
  set->numbers[item.tag] = number;
}

std::optional<double> Get(const KlvSet& set, int tag) {
  const auto found = set.numbers.find(tag);
  return found == set.numbers.end() ? std::nullopt : std::optional<double>(found->second);
}

// The first of the tags that is there.
std::optional<double> Get(const KlvSet& set, int tag, int other) {
  const std::optional<double> value = Get(set, tag);
  return value.has_value() ? value : Get(set, other);
}

std::optional<GeoPoint> Place(const KlvSet& set, int latitude_tag) {
  const std::optional<double> latitude = Get(set, latitude_tag);
  const std::optional<double> longitude = Get(set, latitude_tag + 1);
  if (!latitude.has_value() || !longitude.has_value()) return std::nullopt;
  return GeoPoint{*latitude, *longitude};
}

std::optional<std::array<GeoPoint, 4>> Corners(const KlvSet& set) {
  const std::optional<GeoPoint> centre = Place(set, 23);
  std::array<GeoPoint, 4> corners;
  for (int k = 0; k < 4; ++k) {
    const std::optional<GeoPoint> full = Place(set, 82 + 2 * k);
    const std::optional<GeoPoint> offset = Place(set, 26 + 2 * k);
    if (full.has_value()) {
      corners[static_cast<std::size_t>(k)] = *full;
    } else if (centre.has_value() && offset.has_value()) {
      corners[static_cast<std::size_t>(k)] = {centre->latitude_deg + offset->latitude_deg, centre->longitude_deg + offset->longitude_deg};
    } else {
      return std::nullopt;
    }
  }
  return corners;
}

}  // namespace

bool IsSt0601(Bytes key) { return std::equal(key.begin(), key.end(), kSt0601Key.begin(), kSt0601Key.end()); }
bool IsEg0104(Bytes key) { return std::equal(key.begin(), key.end(), kEg0104Key.begin(), kEg0104Key.end()); }
bool HasChecksum(const KlvSet& set) { return set.numbers.count(kChecksumTag) > 0; }

std::optional<double> ReadImapb(Bytes bytes, double low, double high) {
  const std::uint64_t number = ReadUnsigned(bytes);
  const double bits = 8.0 * static_cast<double>(bytes.size()) - 1.0;
  const std::uint64_t top = std::uint64_t{1} << (8 * bytes.size() - 1);
  // The top bit with any other: a special value (ST 1201.4, 8.3).
  if ((number & top) != 0 && number != top) return std::nullopt;
  const double exponent = std::ceil(std::log2(high - low));
  const double forward = std::exp2(bits - exponent);
  const double zero_offset = low < 0.0 && high > 0.0 ? forward * low - std::floor(forward * low) : 0.0;
  const double value = std::exp2(exponent - bits) * (static_cast<double>(number) - zero_offset) + low;
  if (!(value >= low && value <= high)) return std::nullopt;
  return value;
}

KlvVerdict ReadSt0601(const KlvPacket& packet, KlvSet* set) {
  if (!IsSt0601(packet.key)) return KlvVerdict::kOtherKey;
  Bytes rest = packet.value;
  bool checksum_wrong = false;
  for (std::size_t count = 0; !rest.empty(); ++count) {
    const std::optional<BerLength> tag = ReadBerOid(rest);
    const std::optional<BerLength> length = tag.has_value() ? ReadBerLength(rest.subspan(tag->bytes)) : std::nullopt;
    const std::size_t header = length.has_value() ? tag->bytes + length->bytes : 0;
    if (!length.has_value() || count == kKlvItemsMax || length->value > rest.size() - header) {
      set->first_problem = "item " + std::to_string(count) + (tag.has_value() ? ", tag " + std::to_string(tag->value) : "") +
                           (length.has_value() ? ", has a length of " + std::to_string(length->value) + " bytes where " +
                                                     std::to_string(rest.size() - header) + " are left"
                                               : ", is cut short");
      return KlvVerdict::kImpossibleItems;
    }
    const Bytes value = rest.subspan(header, static_cast<std::size_t>(length->value));
    const auto found = std::find_if(std::begin(kItems), std::end(kItems),
                                    [&tag](const Item& item) { return static_cast<std::uint64_t>(item.tag) == tag->value; });
    if (found != std::end(kItems)) Decode(*found, value, set);
    if (tag->value == kChecksumTag && value.size() == 2) {
      const auto summed = static_cast<std::size_t>(value.data() - packet.whole.data());
      checksum_wrong = Checksum(packet.whole.first(summed)) != ReadUnsigned(value);
      if (checksum_wrong) {
        set->first_problem = "its checksum is " + std::to_string(ReadUnsigned(value)) + ", that of its bytes " +
                             std::to_string(Checksum(packet.whole.first(summed)));
      }
    }
    rest = rest.subspan(header + value.size());
  }
  return checksum_wrong ? KlvVerdict::kBadChecksum : KlvVerdict::kGood;
}

KlvVerdict ReadEg0104(const KlvPacket& packet, KlvSet* set) {
  if (!IsEg0104(packet.key)) return KlvVerdict::kOtherKey;
  Bytes rest = packet.value;
  for (std::size_t count = 0; !rest.empty(); ++count) {
    const std::optional<BerLength> length = rest.size() > kKlvKeyBytes ? ReadBerLength(rest.subspan(kKlvKeyBytes)) : std::nullopt;
    const std::size_t header = length.has_value() ? kKlvKeyBytes + length->bytes : 0;
    if (!length.has_value() || count == kKlvItemsMax || length->value > rest.size() - header) {
      set->first_problem = "item " + std::to_string(count) +
                           (length.has_value() ? " has a length of " + std::to_string(length->value) + " bytes where " +
                                                     std::to_string(rest.size() - header) + " are left"
                                               : " is cut short");
      return KlvVerdict::kImpossibleItems;
    }
    const Bytes key = rest.first(kKlvKeyBytes);
    const Bytes value = rest.subspan(header, static_cast<std::size_t>(length->value));
    const auto found = std::find_if(std::begin(kUniversalItems), std::end(kUniversalItems), [&key](const UniversalItem& item) {
      return std::equal(item.key.begin(), item.key.end(), key.begin() + 4) &&
             std::equal(kSt0601Key.begin(), kSt0601Key.begin() + 4, key.begin());
    });
    if (found != std::end(kUniversalItems)) {
      if (found->coding == Coding::kSigned) {
        DecodeFloat(*found, value, set);
      } else {
        Decode({found->tag, found->coding, found->coding == Coding::kTime ? std::size_t{8} : 0, 0, 0}, value, set);
      }
    }
    rest = rest.subspan(header + value.size());
  }
  return KlvVerdict::kGood;
}

TelemetryRecord RecordFromKlv(const KlvSet& set) {
  TelemetryRecord record;
  if (set.utc_us.has_value() && *set.utc_us < (std::uint64_t{1} << 62U)) record.utc_us = static_cast<std::int64_t>(*set.utc_us);
  record.sensor = Place(set, 13);
  record.altitude_msl_m = Get(set, 15);
  record.altitude_hae_m = Get(set, 104, 75);
  record.platform_heading_deg = Get(set, 5);
  record.platform_pitch_deg = Get(set, 90, 6);
  record.platform_roll_deg = Get(set, 91, 7);
  record.sensor_azimuth_deg = Get(set, 18, kKlvAngleToNorth);
  record.sensor_elevation_deg = Get(set, 19, kKlvObliquity);
  record.sensor_roll_deg = Get(set, 20);
  record.hfov_deg = Get(set, 16);
  record.vfov_deg = Get(set, 17);
  // Zero is what systems send that do not know.
  for (std::optional<double>* positive : {&record.hfov_deg, &record.vfov_deg}) {
    if (positive->has_value() && !(**positive > 0.0 && **positive < 180.0)) positive->reset();
  }
  record.slant_range_m = Get(set, 21);
  if (record.slant_range_m.has_value() && !(*record.slant_range_m > 0.0)) record.slant_range_m.reset();
  record.frame_centre = Place(set, 23);
  record.centre_elevation_msl_m = Get(set, 25);
  record.centre_elevation_hae_m = Get(set, 78);
  record.corners = Corners(set);
  return record;
}

}  // namespace trem
