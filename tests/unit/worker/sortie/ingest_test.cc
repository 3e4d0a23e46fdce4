// Goal: a folder or video becomes a manifest that says what is there: states of odd frames by name, pieces at cuts and gaps, telemetry,
// grey scaling; bad sources end in one clear message. Method: small sorties written here; damaged on purpose.
#include "worker/sortie/ingest.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "proto/codec/convert.h"
#include "tests/support/paths.h"
#include "tests/unit/worker/sortie/test_video.h"
#include "worker/sortie/frame_reader.h"

namespace trem {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;
using testing::TexturedFrame;

constexpr int kWidth = 160;
constexpr int kHeight = 120;

void WritePng(const std::filesystem::path& path, const Image<float>& frame, int depth = 8) {
  cv::Mat pixels(frame.height(), frame.width(), depth == 8 ? CV_8U : CV_16U);
  for (int y = 0; y < frame.height(); ++y) {
    for (int x = 0; x < frame.width(); ++x) {
      if (depth == 8) pixels.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(frame.at(x, y) + 0.5F);
      if (depth == 16) pixels.at<std::uint16_t>(y, x) = static_cast<std::uint16_t>(28000.0F + 10.0F * frame.at(x, y));
    }
  }
  ASSERT_TRUE(cv::imwrite(path.string(), pixels));
}

std::string FrameName(int i) { return "f" + std::to_string(i) + ".png"; }

// Frames of a camera that moves by (3, 2) px a frame.
void WriteLeg(const std::filesystem::path& folder, int first, int count, std::uint64_t seed, int depth = 8) {
  for (int i = first; i < first + count; ++i)
    WritePng(folder / FrameName(i), TexturedFrame(kWidth, kHeight, 3.0 * i, 2.0 * i, seed), depth);
}

v1::Sortie SortieAt(const std::filesystem::path& path) {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path(path.string());
  sortie.mutable_source()->set_frame_rate_hz(10.0);
  return sortie;
}

std::vector<std::string> Codes(const v1::SortieManifest& manifest) {
  std::vector<std::string> codes;
  for (const v1::Note& note : manifest.notes()) codes.push_back(note.code());
  return codes;
}

std::string NoteText(const v1::SortieManifest& manifest, const std::string& code) {
  for (const v1::Note& note : manifest.notes()) {
    if (note.code() == code) return note.subject() + ": " + note.message();
  }
  return "";
}

TEST(Ingest, DescribesAPlainLegOfImages) {
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 12, 1);
  const auto manifest = IngestSortie(SortieAt(folder.path()), {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  ASSERT_EQ(manifest->frames_size(), 12);
  EXPECT_EQ(manifest->frames(10).name(), "f10.png");
  EXPECT_NEAR(manifest->frames(10).time_s(), 1.0, 1e-12);
  EXPECT_EQ(manifest->source_kind(), v1::IMAGE_SEQUENCE);
  EXPECT_EQ(manifest->grey_scale(), 1.0);
  EXPECT_GE(manifest->noise_sigma(), 0.29);
  ASSERT_EQ(manifest->spans_size(), 1);
  EXPECT_EQ(manifest->spans(0).begin(), 0U);
  EXPECT_EQ(manifest->spans(0).end(), 12U);
  EXPECT_EQ(manifest->frames(0).motion_correlation(), 0.0);
  EXPECT_EQ(manifest->frames(0).previous_from_current_size(), 0);
  for (int i = 1; i < 12; ++i) {
    const auto motion = AffineFromProto(manifest->frames(i).previous_from_current(), "motion");
    ASSERT_TRUE(motion.ok());
    // Pixel u of frame i shows what pixel u + (3, 2) of frame i - 1 showed.
    const Eigen::Vector2d centre(80, 60);
    const Eigen::Vector2d moved = *motion * centre;
    EXPECT_NEAR(moved.x(), 83.0, 0.15);
    EXPECT_NEAR(moved.y(), 62.0, 0.15);
  }
  const v1::IngestSummary summary = SummariseManifest(*manifest);
  EXPECT_EQ(summary.usable_frame_count(), 12U);
  EXPECT_NEAR(summary.median_motion_px(), std::hypot(3, 2), 0.1);
}

TEST(Ingest, NamesOddFramesAndGoesOn) {
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 12, 1);
  testing::WriteFileContents(folder / FrameName(3), "This is a text.");
  WritePng(folder / FrameName(5), TexturedFrame(80, 60, 0, 0, 1));
  WritePng(folder / FrameName(7), Image<float>(kWidth, kHeight, 90.0F));
  std::filesystem::copy_file(folder / FrameName(8), folder / FrameName(9), std::filesystem::copy_options::overwrite_existing);
  const auto manifest = IngestSortie(SortieAt(folder.path()), {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->frames(3).state(), v1::FRAME_UNREADABLE);
  EXPECT_EQ(manifest->frames(5).state(), v1::FRAME_WRONG_SIZE);
  EXPECT_EQ(manifest->frames(7).state(), v1::FRAME_BLANK);
  EXPECT_EQ(manifest->frames(9).state(), v1::FRAME_REPEATED);
  EXPECT_THAT(NoteText(*manifest, "frame_unreadable"), HasSubstr("f3.png: frame 3, "));
  EXPECT_THAT(NoteText(*manifest, "frame_unreadable"), HasSubstr("begins with 'This is a t'"));
  EXPECT_THAT(NoteText(*manifest, "frame_wrong_size"), HasSubstr("is 80 x 60 pixels; expected 160 x 120"));
  EXPECT_EQ(SummariseManifest(*manifest).usable_frame_count(), 8U);
  // The frames between are bridged: one piece.
  ASSERT_EQ(manifest->spans_size(), 1);
  auto frames = OpenFrames(*manifest);
  ASSERT_TRUE(frames.ok());
  EXPECT_TRUE((*frames)->Read(2).ok());
  EXPECT_THAT((*frames)->Read(3).status().message(), HasSubstr("frame 3"));
  EXPECT_THAT((*frames)->Read(5).status().message(), HasSubstr("expected 160 x 120"));
  EXPECT_EQ((*frames)->Read(12).status().code(), StatusCode::kInvalidInput);
}

TEST(Ingest, StartsANewPieceAtACut) {
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 6, 1);
  WriteLeg(folder.path(), 6, 5, 2);
  WriteLeg(folder.path(), 11, 1, 3);
  const auto manifest = IngestSortie(SortieAt(folder.path()), {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  ASSERT_EQ(manifest->spans_size(), 2);
  EXPECT_EQ(manifest->spans(0).end(), 6U);
  EXPECT_EQ(manifest->spans(1).begin(), 6U);
  EXPECT_EQ(manifest->spans(1).end(), 11U);
  EXPECT_THAT(NoteText(*manifest, "cut"), HasSubstr("frame 6 "));
  EXPECT_THAT(NoteText(*manifest, "frame_alone"), HasSubstr("frame 11 "));
}

TEST(Ingest, TakesPosesAndTimesFromTelemetryAndStartsANewPieceAtAGap) {
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 8, 1);
  std::string csv = "frame,time_s,latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,hfov_deg,ground_elevation_m,mood\n";
  for (int i = 0; i < 8; ++i) {
    if (i == 2) continue;
    csv +=
        FrameName(i) + "," + std::to_string(0.1 * i + (i > 4 ? 30.0 : 0.0)) + ",50,1,100," + std::to_string(10 * i) + ",-90,0,30,5,fine\n";
  }
  testing::WriteFileContents(folder / "telemetry.csv", csv);
  const auto manifest = IngestSortie(SortieAt(folder.path()), {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->telemetry_source(), v1::TELEMETRY_CSV);
  EXPECT_EQ(manifest->ground_elevation_m(), 5.0);
  EXPECT_NEAR(manifest->frames(2).time_s(), 0.2, 1e-9);
  EXPECT_NEAR(manifest->frames(2).pose().yaw_deg(), 20.0, 1e-6);
  ASSERT_EQ(manifest->spans_size(), 2);
  EXPECT_EQ(manifest->spans(1).begin(), 5U);
  EXPECT_THAT(Codes(*manifest), Contains("time_gap"));
  EXPECT_THAT(Codes(*manifest), Contains("telemetry_column_ignored"));
  EXPECT_THAT(Codes(*manifest), Not(Contains("cut")));
}

TEST(Ingest, ScalesSixteenBitSourcesToTheWorkingRange) {
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 4, 1, 16);
  const auto manifest = IngestSortie(SortieAt(folder.path()), {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->grey_max(), 65535.0);
  // The texture spans about 20..235 in tens of counts.
  EXPECT_NEAR(manifest->grey_scale(), 10.0 * 200 / 235, 2.0);
  EXPECT_GT((28000.0 + 10.0 * 128 - manifest->grey_offset()) / manifest->grey_scale(), 60.0);
  EXPECT_LT((28000.0 + 10.0 * 128 - manifest->grey_offset()) / manifest->grey_scale(), 200.0);
}

TEST(Ingest, DescribesAVideoAndReadsItsFramesBack) {
  const testing::TempDir folder;
  std::vector<Image<float>> frames;
  for (int i = 0; i < 40; ++i) frames.push_back(TexturedFrame(kWidth, kHeight, 3.0 * i, 2.0 * i, 1));
  testing::WriteVideo(folder / "v.ts", frames,
                      {.encoder = "mpeg2video", .pixel_format = "yuv420p", .frame_rate_hz = 25, .interlaced = true});
  v1::Sortie sortie = SortieAt(folder / "v.ts");
  sortie.mutable_source()->set_first_frame(5);
  sortie.mutable_source()->set_max_frames(20);
  const auto manifest = IngestSortie(sortie, {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->frames_size(), 20);
  EXPECT_EQ(manifest->frames(0).name(), "#5");
  EXPECT_NEAR(manifest->frames(1).time_s() - manifest->frames(0).time_s(), 0.04, 1e-4);
  EXPECT_TRUE(manifest->deinterlaced());
  EXPECT_FALSE(manifest->video_from_start());
  EXPECT_EQ(manifest->spans_size(), 1);
  auto reader = OpenFrames(*manifest);
  ASSERT_TRUE(reader.ok());
  const auto late = (*reader)->Read(19);
  const auto early = (*reader)->Read(0);
  ASSERT_TRUE(late.ok() && early.ok());
  // A constant luma code c is shown as (c - 16) * 255 / 219; the frame moved by 3 px each.
  double difference = 0.0;
  for (int y = 20; y < 100; ++y) difference += std::abs(early->at(80, y) - (frames[5].at(80, y) - 16.0F) * 255.0F / 219.0F);
  EXPECT_LT(difference / 80.0, 12.0);
}

TEST(Ingest, GivesTheSameBytesTwice) {
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 6, 1);
  const auto first = IngestSortie(SortieAt(folder.path()), {});
  const auto second = IngestSortie(SortieAt(folder.path()), {});
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_EQ(SerializeDeterministic(*first), SerializeDeterministic(*second));
}

TEST(Ingest, GivesTheSameBytesForAnyNumberOfThreads) {
  // More frames than are read at once, a cut in the middle of a run, and frames that are none.
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 69, 1);
  WriteLeg(folder.path(), 69, 8, 2);
  WritePng(folder / FrameName(30), Image<float>(kWidth, kHeight, 5.0F));
  testing::WriteFileContents(folder / FrameName(64), "no image");
  const auto one = IngestSortie(SortieAt(folder.path()), {}, 1);
  const auto three = IngestSortie(SortieAt(folder.path()), {}, 3);
  ASSERT_TRUE(one.ok() && three.ok());
  EXPECT_EQ(SerializeDeterministic(*one), SerializeDeterministic(*three));
  ASSERT_EQ(one->spans_size(), 2);
  EXPECT_EQ(one->spans(0).end(), 69U);
  for (int i = 1; i < 69; ++i) {
    if (one->frames(i).state() != v1::FRAME_USABLE) continue;
    const double frames = i == 31 || i == 65 ? 2.0 : 1.0;  // Since the usable one before.
    EXPECT_NEAR(one->frames(i).previous_from_current(2), 3.0 * frames, 0.2) << i;
    EXPECT_NEAR(one->frames(i).previous_from_current(5), 2.0 * frames, 0.2) << i;
  }
}

TEST(Ingest, GivesTheSameBytesOfAVideoForAnyNumberOfThreads) {
  // Frames wait, decoded, until a thread takes them; the decoder goes on meanwhile.
  const testing::TempDir folder;
  std::vector<Image<float>> frames;
  for (int i = 0; i < 45; ++i) frames.push_back(TexturedFrame(kWidth, kHeight, 3.0 * i, 2.0 * i, 1));
  testing::WriteVideo(folder / "v.ts", frames, {.encoder = "mpeg2video", .pixel_format = "yuv420p", .frame_rate_hz = 25});
  const auto one = IngestSortie(SortieAt(folder / "v.ts"), {}, 1);
  const auto three = IngestSortie(SortieAt(folder / "v.ts"), {}, 3);
  ASSERT_TRUE(one.ok() && three.ok());
  EXPECT_EQ(one->frames_size(), 45);
  EXPECT_EQ(one->spans_size(), 1);
  EXPECT_EQ(SerializeDeterministic(*one), SerializeDeterministic(*three));
}

TEST(Ingest, SaysWhyASourceIsOfNoUse) {
  const testing::TempDir folder;
  EXPECT_EQ(IngestSortie(SortieAt(folder / "none"), {}).status().code(), StatusCode::kNotFound);
  EXPECT_THAT(IngestSortie(SortieAt(folder.path()), {}).status().message(), HasSubstr("holds no image"));
  testing::WriteFileContents(folder / "x.png", "This is a text.");
  const Status text = IngestSortie(SortieAt(folder.path()), {}).status();
  EXPECT_EQ(text.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(text.message(), HasSubstr("none of its 1 images can be read; the first: frame 0, "));
  WritePng(folder / "x.png", Image<float>(kWidth, kHeight, 5.0F));
  EXPECT_THAT(IngestSortie(SortieAt(folder.path()), {}).status().message(), HasSubstr("blank"));
  v1::Sortie late = SortieAt(folder.path());
  late.mutable_source()->set_first_frame(3);
  EXPECT_THAT(IngestSortie(late, {}).status().message(), HasSubstr("source.first_frame is 3"));
}

TEST(Ingest, RefusesTelemetryThatMatchesNothing) {
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 2, 1);
  testing::WriteFileContents(
      folder / "telemetry.csv",
      "frame,latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,hfov_deg\nother.png,50,1,100,0,-90,0,30\n");
  const Status status = IngestSortie(SortieAt(folder.path()), {}).status();
  EXPECT_EQ(status.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(status.message(), HasSubstr("'other.png'"));
  EXPECT_THAT(status.message(), HasSubstr("'f0.png'"));
}

TEST(Ingest, NotesATruncatedVideo) {
  const testing::TempDir folder;
  std::vector<Image<float>> frames;
  for (int i = 0; i < 30; ++i) frames.push_back(TexturedFrame(kWidth, kHeight, 3.0 * i, 2.0 * i, 1));
  testing::WriteVideo(folder / "v.ts", frames, {.encoder = "mpeg2video", .pixel_format = "yuv420p", .frame_rate_hz = 25});
  std::filesystem::resize_file(folder / "v.ts", std::filesystem::file_size(folder / "v.ts") / 2 / 188 * 188 + 90);
  const auto manifest = IngestSortie(SortieAt(folder / "v.ts"), {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_LT(manifest->frames_size(), 25);
  EXPECT_THAT(NoteText(*manifest, "video_cut_short"), HasSubstr("frames were decoded, up to"));
}

TEST(Ingest, StopsWhenAskedTo) {
  const testing::TempDir folder;
  WriteLeg(folder.path(), 0, 4, 1);
  int calls = 0;
  const auto manifest = IngestSortie(SortieAt(folder.path()), [&calls](double fraction) {
    EXPECT_GE(fraction, 0.0);
    EXPECT_LE(fraction, 1.0);
    return ++calls < 3;
  });
  EXPECT_EQ(manifest.status().code(), StatusCode::kCancelled);
  EXPECT_EQ(calls, 3);
}

TEST(Ingest, LinksEveryFrameOfTheRealSorties) {
  const auto data = testing::TestDataDir();
  if (!data.has_value()) GTEST_SKIP() << "no sample data (../shared/data or TREM_TEST_DATA)";
  for (const char* name : {"fmv/aphill_short.ts", "hit_uav_run", "fmv/aphill_240_1fps_crf32.mp4"}) {
    const auto manifest = IngestSortie(SortieAt(*data / name), {});
    ASSERT_TRUE(manifest.ok()) << manifest.status().message();
    EXPECT_EQ(manifest->spans_size(), 1) << name;
    EXPECT_EQ(static_cast<int>(manifest->spans(0).end()), manifest->frames_size()) << name;
    EXPECT_FALSE(manifest->video_from_start()) << name;
  }
}

}  // namespace
}  // namespace trem
