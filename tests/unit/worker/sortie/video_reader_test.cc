// Goal: a frame of a video has the same pixels whatever was read before it, for codecs that refer forwards and backwards and for
// deinterlaced video, whose frames depend on their neighbours. Method: videos encoded here; a decode from the start gives the reference,
// then frames are read in a shuffled order through seeks (the reader is told never to start from the front) and compared bit by bit.
#include "worker/sortie/video_reader.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>

#include "mosaic/base/rng.h"
#include "tests/support/paths.h"
#include "tests/unit/worker/sortie/test_video.h"
#include "worker/sortie/luma.h"

namespace trem {
namespace {

using testing::TestVideo;
using testing::TexturedFrame;

std::vector<Image<float>> MovingFrames(int count, int width = 64, int height = 48) {
  std::vector<Image<float>> frames;
  for (int i = 0; i < count; ++i) frames.push_back(TexturedFrame(width, height, 2.5 * i, 1.0 * i, 3));
  return frames;
}

struct Decoded {
  std::vector<VideoFrameId> ids;
  std::vector<GreyImage> images;
};

Decoded DecodeAll(const std::string& path, bool deinterlace) {
  Decoded decoded;
  auto stream = VideoStream::Open(path, deinterlace);
  EXPECT_TRUE(stream.ok()) << stream.status().message();
  while (stream.ok()) {
    auto frame = (*stream)->Next();
    EXPECT_TRUE(frame.ok());
    if (!frame.ok() || *frame == nullptr) break;
    auto image = GreyFromVideoFrame(**frame);
    EXPECT_TRUE(image.ok()) << image.status().message();
    decoded.ids.push_back({static_cast<std::int64_t>(decoded.ids.size()), (*frame)->best_effort_timestamp});
    decoded.images.push_back(std::move(image).value());
  }
  return decoded;
}

void ExpectSame(const Image<float>& a, const Image<float>& b, int index) {
  ASSERT_EQ(a.width(), b.width());
  ASSERT_EQ(a.height(), b.height());
  EXPECT_TRUE(std::equal(a.pixels().begin(), a.pixels().end(), b.pixels().begin())) << "frame " << index << " differs";
}

void ExpectRandomAccessIsExact(const std::string& path, bool deinterlace, int frame_count) {
  const Decoded reference = DecodeAll(path, deinterlace);
  ASSERT_EQ(reference.images.size(), static_cast<std::size_t>(frame_count));
  VideoReaderOptions options;
  options.deinterlace = deinterlace;
  options.forward_frames_max = 2;  // Nearly every read is a seek.
  auto reader = VideoReader::Open(path, reference.ids, options);
  ASSERT_TRUE(reader.ok()) << reader.status().message();
  Rng rng({5});
  for (int k = 0; k < 40; ++k) {
    const auto index = static_cast<int>(rng.UniformIndex(static_cast<std::uint32_t>(frame_count)));
    auto image = (*reader)->Read(index);
    ASSERT_TRUE(image.ok()) << image.status().message();
    ExpectSame(image->pixels, reference.images[static_cast<std::size_t>(index)].pixels, index);
  }
  // Only frames near the start, which have no two key frames before them, may be reached from there.
  EXPECT_LT((*reader)->restart_count(), 20) << "of 40 reads";
}

TEST(VideoReader, ReadsTheSamePixelsInAnyOrderWithBFramesInTransportStream) {
  const testing::TempDir folder;
  TestVideo options{.encoder = "mpeg2video", .pixel_format = "yuv420p", .frame_rate_hz = 25, .gop_frames = 9, .b_frames = 2};
  testing::WriteVideo(folder.path() / "v.ts", MovingFrames(90), options);
  ExpectRandomAccessIsExact((folder.path() / "v.ts").string(), false, 90);
}

TEST(VideoReader, ReadsTheSamePixelsInAnyOrderOfH264InMp4) {
  if (!testing::HasEncoder("libx264")) GTEST_SKIP() << "libavcodec has no libx264 encoder";
  const testing::TempDir folder;
  TestVideo options{.encoder = "libx264", .pixel_format = "yuv420p", .gop_frames = 15, .b_frames = 3};
  testing::WriteVideo(folder.path() / "v.mp4", MovingFrames(100), options);
  ExpectRandomAccessIsExact((folder.path() / "v.mp4").string(), false, 100);
}

TEST(VideoReader, ReadsTheSamePixelsInAnyOrderWhenDeinterlacing) {
  const testing::TempDir folder;
  TestVideo options{
      .encoder = "mpeg2video", .pixel_format = "yuv420p", .frame_rate_hz = 25, .gop_frames = 6, .b_frames = 2, .interlaced = true};
  testing::WriteVideo(folder.path() / "v.ts", MovingFrames(70), options);
  auto stream = VideoStream::Open((folder.path() / "v.ts").string(), false);
  ASSERT_TRUE(stream.ok());
  EXPECT_TRUE((*stream)->facts().interlaced);
  ExpectRandomAccessIsExact((folder.path() / "v.ts").string(), true, 70);
}

TEST(VideoReader, ReadsTheSamePixelsInAnyOrderOfIntraOnlyVideo) {
  const testing::TempDir folder;
  testing::WriteVideo(folder.path() / "v.avi", MovingFrames(160), TestVideo{.encoder = "ffv1", .gop_frames = 1});
  ExpectRandomAccessIsExact((folder.path() / "v.avi").string(), false, 160);
}

TEST(VideoReader, ReadsTheSamePixelsInAnyOrderOfRealVideo) {
  const auto data = testing::TestDataDir();
  if (!data.has_value()) GTEST_SKIP() << "no sample data (../shared/data or TREM_TEST_DATA)";
  ExpectRandomAccessIsExact((*data / "fmv/aphill_short.ts").string(), true, 48);
}

TEST(VideoReader, KeepsGreyLevelsOfLosslessGreyVideo) {
  const testing::TempDir folder;
  const auto frames = MovingFrames(3);
  testing::WriteVideo(folder.path() / "v.avi", frames, TestVideo{.encoder = "ffv1"});
  const Decoded decoded = DecodeAll((folder.path() / "v.avi").string(), false);
  ASSERT_EQ(decoded.images.size(), 3U);
  EXPECT_EQ(decoded.images[0].grey_max, 255.0);
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t p = 0; p < frames[i].pixels().size(); ++p) {
      ASSERT_NEAR(decoded.images[i].pixels.pixels()[p], frames[i].pixels()[p], 0.501);
    }
  }
}

TEST(VideoReader, StretchesLimitedRangeLumaToTheFullScale) {
  const testing::TempDir folder;
  Image<float> bars(64, 48, 16.0F);
  for (int y = 0; y < 48; ++y) std::fill_n(bars.row(y) + 32, 32, 235.0F);
  testing::WriteVideo(folder.path() / "v.mkv", {bars}, TestVideo{.encoder = "ffv1", .pixel_format = "yuv420p"});
  const Decoded decoded = DecodeAll((folder.path() / "v.mkv").string(), false);
  ASSERT_EQ(decoded.images.size(), 1U);
  EXPECT_NEAR(decoded.images[0].pixels.at(3, 3), 0.0, 1e-4);
  EXPECT_NEAR(decoded.images[0].pixels.at(60, 3), 255.0, 1e-3);
}

TEST(VideoReader, DecodesTheReadablePartOfATruncatedVideo) {
  const testing::TempDir folder;
  const auto path = folder.path() / "v.ts";
  testing::WriteVideo(path, MovingFrames(60), TestVideo{.encoder = "mpeg2video", .pixel_format = "yuv420p", .frame_rate_hz = 25});
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  const Decoded decoded = DecodeAll(path.string(), false);
  EXPECT_GT(decoded.images.size(), 15U);
  EXPECT_LT(decoded.images.size(), 50U);
}

TEST(VideoReader, NamesAFileThatIsNoVideo) {
  const testing::TempDir folder;
  const auto path = folder.path() / "v.mp4";
  std::ofstream(path) << "This is a text, not a video. ";
  const auto stream = VideoStream::Open(path.string(), false);
  ASSERT_FALSE(stream.ok());
  EXPECT_EQ(stream.status().code(), StatusCode::kInvalidInput);
  EXPECT_NE(stream.status().message().find(path.string()), std::string::npos);
  EXPECT_EQ(VideoStream::Open((folder.path() / "none.mp4").string(), false).status().code(), StatusCode::kNotFound);
}

// A playlist would lead to files that the checks of a sortie's paths have not seen.
TEST(VideoReader, FollowsNoPlaylist) {
  const testing::TempDir folder;
  testing::WriteVideo(folder.path() / "secret.ts", MovingFrames(30),
                      TestVideo{.encoder = "mpeg2video", .pixel_format = "yuv420p", .frame_rate_hz = 25});
  ASSERT_TRUE(VideoStream::Open((folder.path() / "secret.ts").string(), false).ok());
  std::ofstream(folder.path() / "leg.m3u8") << "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:1.2,\nsecret.ts\n#EXT-X-ENDLIST\n";
  std::ofstream(folder.path() / "leg.ffconcat") << "ffconcat version 1.0\nfile secret.ts\n";
  for (const char* name : {"leg.m3u8", "leg.ffconcat"}) {
    EXPECT_EQ(VideoStream::Open((folder.path() / name).string(), false).status().code(), StatusCode::kInvalidInput) << name;
  }
}

TEST(VideoReader, SaysWhichFrameIsNoLongerThere) {
  const testing::TempDir folder;
  const auto path = folder.path() / "v.avi";
  testing::WriteVideo(path, MovingFrames(5), TestVideo{});
  auto reader = VideoReader::Open(path.string(), {{0, 0}, {7, 7}}, {});
  ASSERT_TRUE(reader.ok());
  const auto image = (*reader)->Read(1);
  ASSERT_FALSE(image.ok());
  EXPECT_EQ(image.status().code(), StatusCode::kCorrupt);
  EXPECT_NE(image.status().message().find("frame #7"), std::string::npos);
}

}  // namespace
}  // namespace trem
