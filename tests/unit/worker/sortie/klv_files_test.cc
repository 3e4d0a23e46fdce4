// Goal: real files are read as a reference decoder reads them, and the audit finds what their producers did. Method: the shared recordings,
// where they are present: every tag that is read against the reference's values; residuals of the Fort A.P. Hill clips. Streams muxed here
// show the path through libavformat.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <set>

#include "tests/support/paths.h"
#include "worker/sortie/data_packets.h"
#include "worker/sortie/klv_telemetry.h"
#include "worker/sortie/telemetry_sources.h"
#include "worker/telemetry/klv_sets.h"
#include "worker/telemetry/utc_clock.h"

namespace trem {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Property;

#define SKIP_WITHOUT(data)                                                  \
  const std::optional<std::filesystem::path> data = testing::TestDataDir(); \
  if (!data.has_value()) GTEST_SKIP() << "no sample data (../shared/data or TREM_TEST_DATA)"

std::vector<KlvSet> ReadSets(const std::string& path) {
  std::vector<KlvSet> sets;
  KlvSplitter splitter([&sets](const KlvPacket& packet) {
    KlvSet set;
    EXPECT_EQ(ReadSt0601(packet, &set), KlvVerdict::kGood);
    sets.push_back(set);
  });
  const auto streams = ReadDataPackets(path, [&](int, std::optional<double> pts_s, Bytes bytes) { splitter.Feed(bytes, pts_s); });
  EXPECT_TRUE(streams.ok());
  return sets;
}

TEST(KlvFiles, EveryTagThatIsReadHasTheReferenceDecodersValue) {
  SKIP_WITHOUT(data);
  std::ifstream file(*data / "fmv/video_stream_klv.json");
  const nlohmann::json reference = nlohmann::json::parse(file);
  for (const char* name : {"h264_klv.ts", "mpeg2_klv.ts"}) {
    const std::vector<KlvSet> sets = ReadSets((*data / "fmv" / name).string());
    ASSERT_EQ(sets.size(), reference.size()) << name;
    std::set<int> seen;
    for (std::size_t i = 0; i < sets.size(); ++i) {
      for (const auto& item : reference[i]["value"]) {
        const int tag = item["key"]["integer"];
        const nlohmann::json& value = item["value"];
        const nlohmann::json& number = value.is_object() && value.contains("value") ? value["value"] : value;
        const auto read = sets[i].numbers.find(tag);
        if (read != sets[i].numbers.end()) {
          ASSERT_TRUE(number.is_number()) << tag;
          EXPECT_NEAR(read->second, number.get<double>(), 1e-12 * std::max(1.0, std::abs(number.get<double>())))
              << name << " " << i << " tag " << tag;
          seen.insert(tag);
        } else if (const auto text = sets[i].texts.find(tag); text != sets[i].texts.end()) {
          EXPECT_EQ(text->second, number.get<std::string>()) << tag;
          seen.insert(tag);
        }
      }
      // Nothing is read that the reference does not have, but the checksum.
      for (const auto& [tag, value] : sets[i].numbers) EXPECT_TRUE(tag == 1 || seen.count(tag) > 0) << tag;
    }
    std::cout << name << ": " << seen.size() << " tags of " << sets.size() << " packets agree with the reference decoder\n";
    EXPECT_GE(seen.size(), 60U);
  }
}

TEST(KlvFiles, TheAuditFindsAbsoluteAzimuthFromGridNorthInTheFortAPHillClips) {
  SKIP_WITHOUT(data);
  for (const char* name : {"aphill_short.ts", "aphill_klv_10s.ts"}) {
    const Result<KlvTelemetry> klv = ReadKlvTelemetry((*data / "fmv" / name).string());
    ASSERT_TRUE(klv.ok()) << klv.status().message();
    ASSERT_GE(klv->chosen, 0);
    const TelemetryAudit audit = AuditTelemetry(klv->streams.at(klv->chosen).records, {});
    // Both clips say when they were taken.
    EXPECT_TRUE(UtcClock(klv->streams.at(klv->chosen).records).At(0.0).has_value()) << name;
    std::cout << name << ": " << audit.explanation << "\n";
    ASSERT_EQ(audit.verdict, AuditVerdict::kFits);
    EXPECT_EQ(audit.convention.azimuth, AzimuthReading::kAbsolute);
    EXPECT_EQ(audit.convention.north, NorthReading::kGrid);
    EXPECT_EQ(audit.convention.elevation, ElevationReading::kUp);
    EXPECT_EQ(audit.ground_elevation_m, 0.0);
    EXPECT_LT(audit.residual.centre_m, 1.5);
    EXPECT_LT(audit.residual.centre_95_m, 1.5);
    EXPECT_LT(audit.residual.corners_m, 1.5);
    EXPECT_LT(audit.residual.corners_95_m, 1.5);
    EXPECT_LT(audit.residual.slant_m, 1.5);
    // The standard's reading is far off.
    EXPECT_THAT(audit.explanation, HasSubstr("sensor azimuth relative to the platform, true north"));
  }
}

TEST(KlvFiles, OfSeveralStreamsTheOneWithPosesIsChosenAndAnEmptyOneIsNamed) {
  SKIP_WITHOUT(data);
  const Result<KlvTelemetry> klv = ReadKlvTelemetry((*data / "fmv/h265_tricky_klv.ts").string());
  ASSERT_TRUE(klv.ok());
  EXPECT_EQ(klv->chosen, 1);
  EXPECT_EQ(klv->streams.at(1).st0601, 30);
  EXPECT_EQ(klv->streams.at(2).st0601, 60);
  EXPECT_EQ(klv->streams.at(2).usable(), 0);
  EXPECT_THAT(klv->notes, Contains(Property(&v1::Note::message, HasSubstr("data stream 3: is announced and empty"))));
}

TEST(KlvFiles, AVideoWithoutKlvHasNone) {
  SKIP_WITHOUT(data);
  const Result<KlvTelemetry> klv = ReadKlvTelemetry((*data / "fmv/h264_no_klv.ts").string());
  ASSERT_TRUE(klv.ok());
  EXPECT_EQ(klv->chosen, -1);
  EXPECT_TRUE(klv->streams.empty());
  EXPECT_TRUE(klv->notes.empty());
}

TEST(KlvFiles, APacketWithABadChecksumIsNotUsed) {
  SKIP_WITHOUT(data);
  for (const auto& [name, bad] : {std::pair("DynamicConstantMISMMSPacketData.bin", 1), std::pair("DynamicOnlyMISMMSPacketData.bin", 0)}) {
    const std::string bytes = testing::FileContents(*data / "klv" / name);
    KlvStreamReader reader;
    reader.Feed({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, 0.0);
    const KlvStreamContent content = reader.Finish();
    EXPECT_EQ(content.bad_checksums, bad) << name;
    EXPECT_EQ(content.records.size(), static_cast<std::size_t>(1 - bad)) << name;
  }
}

TEST(KlvFiles, TelemetryThatContradictsItselfIsRefusedWithTheReason) {
  SKIP_WITHOUT(data);
  v1::Sortie sortie;
  sortie.mutable_source()->set_path((*data / "fmv/h264_klv.ts").string());
  const Result<FoundTelemetry> found = FindTelemetry(sortie, 160, 120);
  ASSERT_TRUE(found.ok());
  EXPECT_EQ(found->source, v1::TELEMETRY_NONE);
  EXPECT_THAT(found->notes, Contains(Property(&v1::Note::message, HasSubstr("the sensor and what it sees are"))));
}

}  // namespace
}  // namespace trem
