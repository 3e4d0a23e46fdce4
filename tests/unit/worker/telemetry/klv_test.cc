// Goal: KLV packets are read as the standards say, and no damage is taken for a value: wrong checksums, impossible lengths, reserved
// values, pieces and headers. Method: packets built here by the forward formulas, damaged one way at a time.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/worker/telemetry/klv_builder.h"
#include "worker/telemetry/klv_sets.h"
#include "worker/telemetry/klv_stream.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using testing::KlvBuilder;
using Packet = KlvBuilder::Packet;

constexpr std::uint64_t kStart_us = 1'300'000'000'000'000;

KlvBuilder Usual(std::uint64_t utc_us = kStart_us) {
  KlvBuilder builder;
  builder.Time(utc_us).Unsigned(5, 2, 0, 360, 159.97).Signed(6, 2, 20, -0.43).Signed(7, 2, 50, 3.4);
  builder.Signed(13, 4, 90, 60.1768).Signed(14, 4, 180, 128.4268).Unsigned(15, 2, -900, 19000, 1419.0);
  builder.Unsigned(16, 2, 0, 180, 14.5).Unsigned(17, 2, 0, 180, 11.2).Unsigned(18, 4, 0, 360, 160.7192).Signed(19, 4, 180, -30.79);
  return builder.Unsigned(20, 4, 0, 360, 1.25);
}

KlvStreamContent Read(const std::vector<Packet>& pieces, double interval_s = 0.04) {
  KlvStreamReader reader;
  double pts_s = 0.0;
  for (const Packet& piece : pieces) {
    reader.Feed(piece, pts_s);
    pts_s += interval_s;
  }
  return reader.Finish();
}

TEST(Klv, ReadsTheItemsOfALocalSetWithinTheirResolution) {
  const KlvStreamContent content = Read({Usual().St0601()});
  ASSERT_EQ(content.records.size(), 1U);
  EXPECT_EQ(content.st0601, 1);
  EXPECT_EQ(content.ill_formed + content.error_values + content.impossible + content.bad_checksums + content.without_checksum, 0);
  const TelemetryRecord& record = content.records[0];
  EXPECT_EQ(record.utc_us, static_cast<std::int64_t>(kStart_us));
  EXPECT_NEAR(*record.platform_heading_deg, 159.97, 360.0 / 65535);
  EXPECT_NEAR(*record.platform_pitch_deg, -0.43, 40.0 / 65534);
  EXPECT_NEAR(record.sensor->latitude_deg, 60.1768, 1e-7);
  EXPECT_NEAR(record.sensor->longitude_deg, 128.4268, 1e-7);
  EXPECT_NEAR(*record.altitude_msl_m, 1419.0, 19900.0 / 65535);
  EXPECT_NEAR(*record.sensor_azimuth_deg, 160.7192, 1e-6);
  EXPECT_NEAR(*record.sensor_elevation_deg, -30.79, 1e-6);
  EXPECT_FALSE(record.slant_range_m.has_value());
}

TEST(Klv, FullRangeItemsComeBeforeNarrowOnesAndCornersFromEither) {
  KlvBuilder builder = Usual();
  builder.Signed(90, 4, 90, -0.4315).Signed(91, 4, 90, 3.4058).Unsigned(75, 2, -900, 19000, 1400.0);
  builder.Signed(23, 4, 90, 60.2).Signed(24, 4, 180, 128.5);
  for (int k = 0; k < 4; ++k) builder.Signed(26 + 2 * k, 2, 0.075, 0.01 * k).Signed(27 + 2 * k, 2, 0.075, -0.01 * k);
  KlvBuilder full = builder;
  for (int k = 0; k < 4; ++k) full.Signed(82 + 2 * k, 4, 90, 61.0 + k).Signed(83 + 2 * k, 4, 180, 129.0 + k);
  const KlvStreamContent content = Read({builder.St0601(), full.St0601()});
  ASSERT_EQ(content.records.size(), 2U);
  EXPECT_NEAR(*content.records[0].platform_pitch_deg, -0.4315, 1e-7);
  EXPECT_NEAR(*content.records[0].altitude_hae_m, 1400.0, 0.4);
  EXPECT_NEAR((*content.records[0].corners)[3].latitude_deg, 60.23, 1e-5);
  EXPECT_NEAR((*content.records[0].corners)[3].longitude_deg, 128.47, 1e-5);
  EXPECT_NEAR((*content.records[1].corners)[3].latitude_deg, 64.0, 1e-7);
}

TEST(Klv, ReservedValuesAndEmptyItemsAreAbsentNotNumbers) {
  KlvBuilder builder;
  builder.Time(kStart_us).Item(13, KlvBuilder::BigEndian(0x80000000, 4)).Signed(14, 4, 180, 10.0).Item(19, {});
  builder.Item(6, KlvBuilder::BigEndian(0x8000, 2)).Item(104, KlvBuilder::Hex("c80000")).Unsigned(18, 4, 0, 360, 90);
  const KlvStreamContent content = Read({builder.St0601()});
  ASSERT_EQ(content.records.size(), 1U);
  EXPECT_EQ(content.error_values, 3);
  EXPECT_FALSE(content.records[0].sensor.has_value());
  EXPECT_FALSE(content.records[0].sensor_elevation_deg.has_value());
  EXPECT_FALSE(content.records[0].platform_pitch_deg.has_value());
  EXPECT_FALSE(content.records[0].altitude_hae_m.has_value());
  EXPECT_TRUE(content.records[0].sensor_azimuth_deg.has_value());
}

// ST 1201's mapping, forward: floor(2^(8 n - 1 - ceil(log2(high - low))) * (x - low) + offset).
Packet Imapb(double low, double high, int bytes, double x) {
  const double scale = std::exp2(8.0 * bytes - 1.0 - std::ceil(std::log2(high - low)));
  const double offset = low < 0.0 && high > 0.0 ? scale * low - std::floor(scale * low) : 0.0;
  return KlvBuilder::BigEndian(static_cast<std::uint64_t>(scale * (x - low) + offset), bytes);
}

TEST(Klv, ImapbIsInvertedToItsStepAndZeroIsExact) {
  for (const int bytes : {2, 3, 4, 8}) {
    for (const double x : {-900.0, -1.5, 0.0, 23456.24, 40000.0}) {
      const double step = std::exp2(std::ceil(std::log2(40900.0)) - (8.0 * bytes - 1.0));
      const std::optional<double> read = ReadImapb(Imapb(-900, 40000, bytes, x), -900, 40000);
      ASSERT_TRUE(read.has_value()) << bytes << " " << x;
      EXPECT_NEAR(*read, x, step + 1e-9);
      EXPECT_TRUE(x != 0.0 || std::abs(*read) < 1e-9);
    }
  }
  // 0x80..0 is the upper end of a range of a power of two; the top bit with others: infinities and NaN.
  EXPECT_EQ(ReadImapb(KlvBuilder::Hex("8000"), 0.0, 4.0), 4.0);
  for (const char* special : {"c800", "e800", "d000", "f800", "e100", "c001"})
    EXPECT_FALSE(ReadImapb(KlvBuilder::Hex(special), 0.0, 4.0).has_value());
}

TEST(Klv, PacketsWithAWrongChecksumAreNotUsedAndCounted) {
  Packet damaged = Usual(kStart_us + 40'000).St0601();
  damaged[30] ^= 0x10U;
  const KlvStreamContent content = Read({Usual().St0601(), damaged, Usual(kStart_us + 80'000).St0601(false)});
  EXPECT_EQ(content.records.size(), 2U);
  EXPECT_EQ(content.bad_checksums, 1);
  EXPECT_EQ(content.without_checksum, 1);
  EXPECT_THAT(content.first_bad_checksum, HasSubstr("KLV packet 1: its checksum is "));
}

TEST(Klv, ImpossibleLengthsAreCountedAndTheNextPacketIsReadAllTheSame) {
  Packet huge = KlvBuilder::Hex("060e2b34020b01010e01030101000000847fffffff0102");
  Packet indefinite = KlvBuilder::Hex("060e2b34020b01010e0103010100000080");
  // An item that claims 100 bytes of a packet with fewer.
  Packet item = KlvBuilder::Hex("060e2b34020b01010e0103010100000004056401ff");
  Packet cut = Usual(kStart_us + 10).St0601();
  cut.resize(cut.size() - 20);
  const KlvStreamContent content = Read({huge, indefinite, item, cut, Usual().St0601()});
  EXPECT_EQ(content.records.size(), 1U);
  EXPECT_EQ(content.impossible, 3);
  EXPECT_EQ(content.cut_short, 1);
  EXPECT_THAT(content.first_problem, HasSubstr("item 0, tag 5, has a length of 100 bytes where 2 are left"));
}

TEST(Klv, ItemsOfAWrongLengthAreLeftOutAloneAndNamed) {
  KlvBuilder builder = Usual();
  builder.Item(21, {1, 2});
  const KlvStreamContent content = Read({builder.St0601()});
  ASSERT_EQ(content.records.size(), 1U);
  EXPECT_EQ(content.ill_formed, 1);
  EXPECT_THAT(content.first_problem, HasSubstr("KLV packet 0: tag 21 has 2 bytes; expected 4"));
  EXPECT_FALSE(content.records[0].slant_range_m.has_value());
  EXPECT_TRUE(content.records[0].HasPointing());
}

TEST(Klv, PacketsAreFoundBehindHeadersInPiecesAndSeveralAtOnce) {
  std::vector<Packet> packets;
  for (int i = 0; i < 4; ++i) packets.push_back(Usual(kStart_us + 40'000U * static_cast<unsigned>(i)).St0601());
  // A metadata access unit header before the first; the second in three pieces; the other two in one piece.
  Packet first = {0x00, 0x01, 0xcf, 0x00, 0x5a};
  first.insert(first.end(), packets[0].begin(), packets[0].end());
  const std::ptrdiff_t third = static_cast<std::ptrdiff_t>(packets[1].size() / 3);
  const Packet a(packets[1].begin(), packets[1].begin() + third);
  const Packet b(packets[1].begin() + third, packets[1].begin() + 2 * third);
  const Packet c(packets[1].begin() + 2 * third, packets[1].end());
  Packet two = packets[2];
  two.insert(two.end(), packets[3].begin(), packets[3].end());
  const KlvStreamContent content = Read({first, a, b, c, two});
  EXPECT_EQ(content.records.size(), 4U);
  EXPECT_EQ(content.cut_short + content.impossible, 0);
}

TEST(Klv, UniversalSetsAreReadAndValuesOutOfRangeLeftOut) {
  KlvBuilder builder;
  builder.Universal("010101030702010101050000", KlvBuilder::BigEndian(kStart_us, 8));
  builder.Float("010101030701020102040200", 38.25, 8)
      .Float("010101030701020102060200", -77.36, 8)
      .Float("010101010701020102020000", 1054.4, 4);
  builder.Float("010101010701100102000000", 124.5, 4).Float("010101010701100103000000", -37.5, 4).Float("010101020420020101080000", 0.8, 4);
  builder.Float("010101010701080101000000", 1730.0, 4)
      .Float("010101010701020103020000", 95.0, 8)
      .Float("010101010701020103040000", -77.35, 8);
  const KlvStreamContent content = Read({builder.Eg0104()});
  ASSERT_EQ(content.records.size(), 1U);
  EXPECT_EQ(content.eg0104, 1);
  EXPECT_EQ(content.without_checksum, 0);
  const TelemetryRecord& record = content.records[0];
  EXPECT_EQ(record.sensor->latitude_deg, 38.25);
  EXPECT_NEAR(*record.altitude_msl_m, 1054.4, 1e-4);
  EXPECT_EQ(record.sensor_azimuth_deg, 124.5);
  EXPECT_EQ(record.sensor_elevation_deg, -37.5);
  EXPECT_FALSE(record.frame_centre.has_value());
  EXPECT_EQ(content.ill_formed, 1);
  EXPECT_THAT(content.first_problem, HasSubstr("tag 23 is 95"));
}

TEST(Klv, StampsTakeTheJitterOutOfPresentationTimes) {
  KlvStreamReader reader;
  for (int i = 0; i < 200; ++i) {
    const double jitter_s = 0.02 * std::sin(12.9898 * i);
    reader.Feed(Usual(kStart_us + 40'000U * static_cast<unsigned>(i)).St0601(), 3.0 + 0.04 * i + jitter_s);
  }
  const KlvStreamContent content = reader.Finish();
  ASSERT_EQ(content.records.size(), 200U);
  EXPECT_THAT(content.clock, HasSubstr("precision time stamps"));
  for (int i = 0; i < 200; ++i) EXPECT_NEAR(content.records[static_cast<std::size_t>(i)].time_s, 3.0 + 0.04 * i, 0.004);
}

TEST(Klv, PresentationTimesServeWhereStampsStandStill) {
  const KlvStreamContent content = Read({Usual().St0601(), Usual().St0601(), Usual().St0601()});
  ASSERT_EQ(content.records.size(), 3U);
  EXPECT_THAT(content.clock, HasSubstr("stand still"));
  EXPECT_NEAR(content.records[2].time_s, 0.08, 1e-12);
}

}  // namespace
}  // namespace trem
