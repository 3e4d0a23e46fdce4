// Goal: CompleteSortie fills in the documented defaults, accepts the ends of every range and refuses what lies beyond, naming the field.
// Method: a table of overrides, one field at a time, on a spec that is otherwise empty.
#include <gmock/gmock.h>
#include <google/protobuf/util/message_differencer.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "proto/codec/sortie_spec.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

v1::Sortie Minimal() {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path("/data/leg3/*.png");
  return sortie;
}

Status CompleteWith(const std::vector<std::string>& assignments) {
  v1::Sortie sortie = Minimal();
  for (const std::string& assignment : assignments) {
    if (Status status = ApplyOverride(assignment, &sortie); !status.ok()) return status;
  }
  return CompleteSortie(&sortie);
}

TEST(CompleteSortie, FillsInTheDocumentedDefaults) {
  v1::Sortie sortie = Minimal();
  ASSERT_TRUE(CompleteSortie(&sortie).ok());
  EXPECT_EQ(sortie.name(), "leg3");
  EXPECT_EQ(sortie.source().frame_rate_hz(), 25.0);
  EXPECT_EQ(sortie.telemetry().position_sigma_m(), 1.0);
  EXPECT_EQ(sortie.telemetry().attitude_sigma_deg(), 0.1);
  EXPECT_FALSE(sortie.telemetry().has_ground_elevation_m());
  EXPECT_EQ(sortie.sensor().psf_model(), v1::GAUSSIAN);
  EXPECT_EQ(sortie.sensor().psf_sigma_px(), 0.0) << "estimated";
  EXPECT_EQ(sortie.sensor().fill_factor(), 0.9);
  EXPECT_EQ(sortie.sensor().noise_sigma(), 0.0);
  EXPECT_EQ(sortie.tre().ratio(), 3u);
  EXPECT_EQ(sortie.tre().registration(), v1::REGISTRATION_AUTO);
  EXPECT_EQ(sortie.tre().update(), v1::UPDATE_AUTO);
  EXPECT_EQ(sortie.tre().structure(), v1::STRUCTURE_AUTO);
  EXPECT_EQ(sortie.tre().structure_weight(), 1.0);
  EXPECT_EQ(sortie.windows().roi_px(), 201u);
  EXPECT_EQ(sortie.windows().roi_overlap_px(), 40u);
  EXPECT_EQ(sortie.windows().frames(), 96u);
  EXPECT_EQ(sortie.windows().frame_overlap(), 24u);
  EXPECT_EQ(sortie.mosaic().tile_px(), 512u);
}

TEST(CompleteSortie, CompletingTwiceChangesNothing) {
  v1::Sortie once = Minimal();
  ASSERT_TRUE(CompleteSortie(&once).ok());
  v1::Sortie twice = once;
  ASSERT_TRUE(CompleteSortie(&twice).ok());
  EXPECT_TRUE(google::protobuf::util::MessageDifferencer::Equals(once, twice));
}

TEST(CompleteSortie, AcceptsTheEndsOfEveryRange) {
  for (const std::vector<std::string>& assignments : std::vector<std::vector<std::string>>{
           {"sensor.psf_sigma_px=0.05", "sensor.fill_factor=0.05", "tre.ratio=2", "windows.roi_px=41", "windows.roi_overlap_px=20"},
           {"sensor.psf_sigma_px=3", "sensor.fill_factor=1", "tre.ratio=4", "windows.roi_px=1024", "windows.roi_overlap_px=511"},
           {"windows.frames=2"},
           {"windows.frames=4096", "windows.frame_overlap=4095"},
           {"tre.forgetting=1"},
           {"tre.update=LANDWEBER", "tre.landweber_window=1"},
           {"tre.update=LANDWEBER", "tre.landweber_window=64", "tre.landweber_revisit=true"},
           {"tre.update=POINTWISE", "tre.structure=LAPLACIAN"},
           {"tre.structure=BILATERAL_TV"},
           {"tre.forgetting=1e-9"},
           {"mosaic.tile_px=64"},
           {"mosaic.tile_px=4096"}}) {
    const Status status = CompleteWith(assignments);
    EXPECT_TRUE(status.ok()) << assignments.front() << ": " << status.message();
  }
}

TEST(CompleteSortie, RefusesWhatLiesBeyondAndNamesTheField) {
  for (const std::vector<std::string>& assignments : std::vector<std::vector<std::string>>{{"sensor.psf_sigma_px=0.04"},
                                                                                           {"sensor.psf_sigma_px=3.01"},
                                                                                           {"sensor.fill_factor=1.01"},
                                                                                           {"sensor.fill_factor=-0.5"},
                                                                                           {"sensor.noise_sigma=-1"},
                                                                                           {"tre.ratio=1"},
                                                                                           {"tre.ratio=5"},
                                                                                           {"tre.forgetting=1.001"},
                                                                                           {"tre.landweber_window=65"},
                                                                                           {"tre.landweber_revisit=true"},
                                                                                           {"tre.forgetting=-0.1"},
                                                                                           {"tre.structure_weight=-1"},
                                                                                           {"tre.iterations=1001"},
                                                                                           {"tre.dynamics_sigma_px=-1"},
                                                                                           {"tre.dynamics_sigma_px=0.0001"},
                                                                                           {"windows.roi_px=40"},
                                                                                           {"windows.roi_px=1025"},
                                                                                           {"windows.roi_overlap_px=101"},
                                                                                           {"windows.roi_overlap_px=4294967295"},
                                                                                           {"windows.frames=1"},
                                                                                           {"windows.frames=4097"},
                                                                                           {"windows.frame_overlap=96"},
                                                                                           {"mosaic.tile_px=63"},
                                                                                           {"mosaic.tile_px=500"},
                                                                                           {"mosaic.tile_px=4112"},
                                                                                           {"mosaic.gsd=-1"},
                                                                                           {"source.frame_rate_hz=-25"},
                                                                                           {"telemetry.position_sigma_m=-1"},
                                                                                           {"telemetry.attitude_sigma_deg=91"},
                                                                                           {"telemetry.ground_elevation_m=1e5"},
                                                                                           {"telemetry.dem_path=/d.tif", "telemetry.ground_elevation_m=3"},
                                                                                           {"telemetry.hfov_deg=180"},
                                                                                           {"telemetry.yaw_deg=361"},
                                                                                           {"telemetry.pitch_deg=-91"},
                                                                                           {"telemetry.roll_deg=361"},
                                                                                           {"telemetry.time_offset_s=1e6"}}) {
    const Status status = CompleteWith(assignments);
    const std::string field = assignments.front().substr(0, assignments.front().find('='));
    EXPECT_EQ(status.code(), StatusCode::kInvalidInput) << assignments.front();
    EXPECT_THAT(status.message(), StartsWith(field + " is "));
    EXPECT_THAT(status.message(), HasSubstr("; expected "));
  }
}

// What describes the PSF follows from what is given, and a model that lacks something is refused by the field that is missing.
TEST(CompleteSortie, ThePsfModelFollowsFromWhatIsGiven) {
  const auto model_with = [](const std::vector<std::string>& assignments) {
    v1::Sortie sortie = Minimal();
    for (const std::string& assignment : assignments) EXPECT_TRUE(ApplyOverride(assignment, &sortie).ok());
    const Status status = CompleteSortie(&sortie);
    EXPECT_TRUE(status.ok()) << status.message();
    return sortie.sensor().psf_model();
  };
  EXPECT_EQ(model_with({}), v1::GAUSSIAN);
  EXPECT_EQ(model_with({"sensor.f_number=4", "sensor.wavelength_um=4", "sensor.pixel_pitch_um=15"}), v1::OPTICS);
  EXPECT_EQ(model_with({"sensor.psf_model=GAUSSIAN", "sensor.f_number=4"}), v1::GAUSSIAN);
  for (const auto& [assignments, field] : std::vector<std::pair<std::vector<std::string>, std::string>>{
           {{"sensor.f_number=4", "sensor.wavelength_um=4"}, "sensor.pixel_pitch_um"},
           {{"sensor.psf_model=OPTICS"}, "sensor.wavelength_um"},
           {{"sensor.f_number=4", "sensor.wavelength_um=30", "sensor.pixel_pitch_um=15"}, "sensor.wavelength_um"},
           {{"sensor.f_number=100", "sensor.wavelength_um=10", "sensor.pixel_pitch_um=15"}, "sensor.wavelength_um * f_number / pixel_pitch_um"},
           {{"sensor.smear_px=10.1"}, "sensor.smear_px"},
           {{"sensor.smear_px=1", "sensor.smear_direction_deg=400"}, "sensor.smear_direction_deg"}}) {
    EXPECT_THAT(CompleteWith(assignments).message(), StartsWith(field)) << assignments.front();
  }
}

TEST(CompleteSortie, RefusesNumbersThatAreNotFinite) {
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()}) {
    for (const char* path : {"psf", "fill", "noise", "forgetting", "weight", "gsd", "rate", "position", "attitude", "elevation"}) {
      v1::Sortie sortie = Minimal();
      const std::string_view field = path;
      if (field == "psf") sortie.mutable_sensor()->set_psf_sigma_px(bad);
      if (field == "fill") sortie.mutable_sensor()->set_fill_factor(bad);
      if (field == "noise") sortie.mutable_sensor()->set_noise_sigma(bad);
      if (field == "forgetting") sortie.mutable_tre()->set_forgetting(bad);
      if (field == "weight") sortie.mutable_tre()->set_structure_weight(bad);
      if (field == "gsd") sortie.mutable_mosaic()->set_gsd(bad);
      if (field == "rate") sortie.mutable_source()->set_frame_rate_hz(bad);
      if (field == "position") sortie.mutable_telemetry()->set_position_sigma_m(bad);
      if (field == "attitude") sortie.mutable_telemetry()->set_attitude_sigma_deg(bad);
      if (field == "elevation") sortie.mutable_telemetry()->set_ground_elevation_m(bad);
      EXPECT_FALSE(CompleteSortie(&sortie).ok()) << field << " " << bad;
    }
  }
}

TEST(CompleteSortie, RefusesMissingSourceUnknownEnumerationsAndTextsThatAreNotUtf8) {
  v1::Sortie empty;
  EXPECT_THAT(CompleteSortie(&empty).message(), StartsWith("source.path is missing"));
  v1::Sortie sortie = Minimal();
  sortie.mutable_tre()->set_registration(static_cast<v1::RegistrationMethod>(77));
  EXPECT_THAT(CompleteSortie(&sortie).message(), StartsWith("tre.registration is 77"));
  sortie = Minimal();
  sortie.mutable_source()->set_path("/data/\xff\xfe");
  EXPECT_EQ(CompleteSortie(&sortie).message(), "source.path is not valid UTF-8; expected UTF-8 text");
  sortie = Minimal();
  sortie.set_name(std::string("a\nb"));
  EXPECT_THAT(CompleteSortie(&sortie).message(), StartsWith("name is a text with control characters"));
}

}  // namespace
}  // namespace trem
