// Goal: a spec means the same as text proto, as JSON and as overrides, and every mistake in one is a single sentence that names the
// place, what was found and what was expected. Method: small specs given as text; messages compared whole.
#include "proto/codec/sortie_spec.h"

#include <gmock/gmock.h>
#include <google/protobuf/util/json_util.h>
#include <google/protobuf/util/message_differencer.h>
#include <gtest/gtest.h>

#include <limits>

namespace trem {
namespace {

using ::google::protobuf::util::MessageDifferencer;
using ::testing::HasSubstr;
using ::testing::StartsWith;

std::string ErrorOf(std::string_view text, const std::string& file_name) {
  const auto parsed = ParseSortieSpec(text, file_name);
  if (parsed.ok()) return "parsed: " + parsed->ShortDebugString();
  EXPECT_EQ(parsed.status().code(), StatusCode::kInvalidInput);
  return parsed.status().message();
}

std::string OverrideError(const std::string& assignment) {
  v1::Sortie sortie;
  const Status status = ApplyOverride(assignment, &sortie);
  return status.ok() ? "applied: " + sortie.ShortDebugString() : status.message();
}

TEST(SortieSpec, ReadsTheSameMessageFromTextAndJson) {
  const auto text = ParseSortieSpec(
      "name: \"leg 3\"\nsource { path: \"frames\" frame_rate_hz: 12.5 deinterlace: DEINTERLACE_NEVER }\n"
      "telemetry { ignore: true ground_elevation_m: -3 }\ntre { ratio: 4 }\nseed: 18446744073709551615\n",
      "a.textproto");
  const auto json = ParseSortieSpec(
      R"({"name": "leg 3", "source": {"path": "frames", "frameRateHz": 12.5, "deinterlace": "DEINTERLACE_NEVER"},
          "telemetry": {"ignore": true, "ground_elevation_m": -3}, "tre": {"ratio": 4.0}, "seed": "18446744073709551615"})",
      "a.json");
  ASSERT_TRUE(text.ok()) << text.status().message();
  ASSERT_TRUE(json.ok()) << json.status().message();
  EXPECT_TRUE(MessageDifferencer::Equals(*text, *json)) << text->ShortDebugString() << "\n" << json->ShortDebugString();
  EXPECT_EQ(text->seed(), std::numeric_limits<std::uint64_t>::max());
}

TEST(SortieSpec, ReadsBackTheJsonThatProtobufWrites) {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path("a \"quoted\\\" folder");
  sortie.set_seed(7);
  ASSERT_TRUE(CompleteSortie(&sortie).ok());
  std::string json;
  ASSERT_TRUE(google::protobuf::util::MessageToJsonString(sortie, &json).ok());
  const auto parsed = ParseSortieSpec(json, "b.json");
  ASSERT_TRUE(parsed.ok()) << parsed.status().message();
  EXPECT_TRUE(MessageDifferencer::Equals(sortie, *parsed));
}

TEST(SortieSpec, NamesPlaceAndNearestNameOfAnUnknownFieldInTextProto) {
  EXPECT_EQ(ErrorOf("source { path: \"x\" }\ntre {\n\t ratoi: 3\n}\n", "s.textproto"),
            "s.textproto:3:3: unknown field 'ratoi' in trem.v1.Tre; did you mean 'ratio'?");
}

TEST(SortieSpec, NamesPlaceAndNearestNameOfAnUnknownFieldInJson) {
  EXPECT_EQ(ErrorOf("{\n \"source\": {\"path\": \"x\"},\n  \"tre\": {\"ratoi\": 3}}", "s.json"),
            "s.json:3:11: unknown field 'ratoi' in trem.v1.Tre; did you mean 'ratio'?");
}

TEST(SortieSpec, ListsTheFieldsWhenNoneIsNear) {
  EXPECT_EQ(ErrorOf("mosaic { zebra: 3 }", "s.textproto"),
            "s.textproto:1:10: unknown field 'zebra' in trem.v1.Mosaic; it has gsd, crs, tile_px, estimator, compression, pixel_type, "
            "bounds, cutline_path, baseline");
}

TEST(SortieSpec, ListsTheValuesOfAnEnumeration) {
  const char* expected =
      "unknown value 'HINT' of registration; expected one of REGISTRATION_AUTO, GAUSS_NEWTON, HINTS, "
      "HINTS_THEN_GAUSS_NEWTON, PAIRWISE; did you mean 'HINTS'?";
  EXPECT_EQ(ErrorOf("tre { registration: HINT }", "s.textproto"), std::string("s.textproto:1:21: ") + expected);
  EXPECT_EQ(ErrorOf("{\"tre\": {\"registration\": \"HINT\"}}", "s.json"), std::string("s.json:1:26: ") + expected);
}

TEST(SortieSpec, SaysWhatTypeWasExpectedInJson) {
  EXPECT_EQ(ErrorOf("{\"tre\": {\"ratio\": -1}}", "s.json"),
            "s.json:1:19: field 'ratio': expected a whole number from 0 to 4294967295, found -1");
  EXPECT_EQ(ErrorOf("{\"tre\": {\"ratio\": 2.5}}", "s.json"),
            "s.json:1:19: field 'ratio': expected a whole number from 0 to 4294967295, found 2.5");
  EXPECT_EQ(ErrorOf("{\"tre\": 3}", "s.json").substr(0, 59), "s.json:1:9: field 'tre': expected a group of fields (ratio,");
  EXPECT_EQ(ErrorOf("{\"name\": [1]}", "s.json"), "s.json:1:10: field 'name': expected a text, found a list [...]");
  EXPECT_EQ(ErrorOf("{\"name\": {\"a\": 1}}", "s.json"), "s.json:1:10: field 'name': expected a text, found a group {...}");
  EXPECT_EQ(ErrorOf("{\"telemetry\":\n{\"ignore\": \"yes\"}}", "s.json"),
            "s.json:2:12: field 'ignore': expected true or false, found the text 'yes'");
  EXPECT_EQ(ErrorOf("{\"mosaic\": {\"gsd\": \"NaN\"}}", "s.json"),
            "s.json:1:20: field 'gsd': expected a finite number, found the text 'NaN'");
}

TEST(SortieSpec, PointsBehindANumberThatClosesAGroup) {
  EXPECT_THAT(ErrorOf("{\"tre\":{\"ratio\":3},\"nam\":1}", "s.json"), StartsWith("s.json:1:20: unknown field 'nam'"));
  EXPECT_THAT(ErrorOf("{\"tre\":{\"ratio\":3,\"x\":1}}", "s.json"), StartsWith("s.json:1:19: unknown field 'x'"));
}

TEST(SortieSpec, RefusesRepeatedFieldsBrokenSyntaxAndOtherTopLevels) {
  EXPECT_EQ(ErrorOf("{\"seed\": 1, \"seed\": 2}", "s.json"), "s.json:1:13: field 'seed' is given twice");
  EXPECT_THAT(ErrorOf("{\"seed\": 1,, }", "s.json"), StartsWith("s.json:1:12: syntax error"));
  EXPECT_THAT(ErrorOf("", "s.json"), StartsWith("s.json:1:1: "));
  EXPECT_THAT(ErrorOf("[]", "s.json"), HasSubstr("expected one object {...} of type trem.v1.Sortie"));
  EXPECT_THAT(ErrorOf("3", "s.json"), HasSubstr("s.json:1:1: expected one object"));
  EXPECT_THAT(ErrorOf("{} {}", "s.json"), StartsWith("s.json:1:4: "));
  EXPECT_THAT(ErrorOf("seed: 1 seed: 2", "s.textproto"), HasSubstr("s.textproto:1:"));
  EXPECT_THAT(ErrorOf("tre { ratio: }", "s.textproto"), StartsWith("s.textproto:1:14: "));
}

TEST(SortieSpec, RefusesTooLargeAndTooDeepTexts) {
  EXPECT_THAT(ErrorOf(std::string((1u << 20) + 1, ' '), "s.json"), HasSubstr("1048577 bytes; a sortie spec has at most 1048576"));
  std::string deep;
  for (int i = 0; i < 1000; ++i) deep += "{\"tre\":";
  EXPECT_THAT(ErrorOf(deep, "s.json"), HasSubstr("unknown field 'tre'"));
  EXPECT_THAT(ErrorOf(std::string(100000, '{'), "s.textproto"), StartsWith("s.textproto:1:1: "));
}

TEST(SortieOverride, SetsEveryTypeOfField) {
  v1::Sortie sortie;
  for (const char* assignment : {"tre.ratio=3", "tre.registration=hints", "source.deinterlace=always", "telemetry.ignore=true",
                                 "telemetry.ground_elevation_m=-12.5", "source.path=a=b", "seed=99", "mosaic.gsd=1e-1"}) {
    const Status status = ApplyOverride(assignment, &sortie);
    EXPECT_TRUE(status.ok()) << status.message();
  }
  EXPECT_EQ(sortie.tre().ratio(), 3u);
  EXPECT_EQ(sortie.tre().registration(), v1::HINTS);
  EXPECT_EQ(sortie.source().deinterlace(), v1::DEINTERLACE_ALWAYS);
  EXPECT_TRUE(sortie.telemetry().ignore());
  EXPECT_EQ(sortie.telemetry().ground_elevation_m(), -12.5);
  EXPECT_EQ(sortie.source().path(), "a=b");
  EXPECT_EQ(sortie.seed(), 99u);
  EXPECT_EQ(sortie.mosaic().gsd(), 0.1);
  EXPECT_TRUE(ApplyOverride("telemetry.ground_elevation_m=", &sortie).ok());
  EXPECT_FALSE(sortie.telemetry().has_ground_elevation_m());
}

TEST(SortieOverride, NamesPathValueAndExpectation) {
  EXPECT_EQ(OverrideError("tre.ratoi=3"), "--set tre.ratoi=3: unknown field 'ratoi' in trem.v1.Tre; did you mean 'ratio'?");
  EXPECT_EQ(OverrideError("tre.ratio=3x"), "--set tre.ratio=3x: expected a whole number from 0 to 4294967295, found '3x'");
  EXPECT_EQ(OverrideError("mosaic.gsd=nan"), "--set mosaic.gsd=nan: expected a finite number, found 'nan'");
  EXPECT_THAT(OverrideError("tre=3"), HasSubstr("set one of them, for example tre.ratio=..."));
  EXPECT_THAT(OverrideError("tre.ratio.x=3"), HasSubstr("'ratio' is a whole number from 0 to 4294967295 and has no field 'x'"));
  EXPECT_THAT(OverrideError("tre.update=fast"), HasSubstr("unknown value 'fast' of update; expected one of UPDATE_AUTO, INFORMATION"));
  EXPECT_THAT(OverrideError("tre.ratio"), HasSubstr("expected FIELD=VALUE"));
  EXPECT_THAT(OverrideError("=3"), HasSubstr("expected FIELD=VALUE"));
  EXPECT_THAT(OverrideError("."), HasSubstr("expected FIELD=VALUE"));
}

}  // namespace
}  // namespace trem
