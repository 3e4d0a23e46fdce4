// Goal: the INGEST task stores a manifest that reads back, tells the planner what it needs, and gives the same artefact twice. Method: a
// small folder of images and a store in a temporary folder.
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "proto/codec/convert.h"
#include "tests/support/paths.h"
#include "tests/unit/worker/sortie/test_video.h"
#include "worker/tasks/task.h"

namespace trem {
namespace {

TEST(IngestTask, StoresTheSameManifestTwice) {
  const testing::TempDir folder;
  std::filesystem::create_directories(folder / "frames");
  for (int i = 0; i < 4; ++i) {
    const Image<float> frame = testing::TexturedFrame(96, 64, 2.0 * i, 1.0 * i, 1);
    cv::Mat pixels(64, 96, CV_8U);
    for (int p = 0; p < 96 * 64; ++p) pixels.data[p] = static_cast<std::uint8_t>(frame.pixels()[static_cast<std::size_t>(p)]);
    ASSERT_TRUE(cv::imwrite((folder / "frames" / std::to_string(i)).string() + ".png", pixels));
  }
  const auto store = ArtefactStore::Open(folder / "store");
  ASSERT_TRUE(store.ok());
  v1::TaskSpec spec;
  spec.set_kind(v1::INGEST);
  spec.mutable_sortie()->mutable_source()->set_path((folder / "frames").string());
  double last = -1.0;
  TaskContext context;
  context.store = &*store;
  context.progress = [&last](double fraction) {
    last = fraction;
    return true;
  };
  const auto first = RunIngestTask(spec, context);
  ASSERT_TRUE(first.ok()) << first.status().message();
  EXPECT_EQ(last, 1.0);
  ASSERT_EQ(first->outputs_size(), 1);
  EXPECT_EQ(first->outputs(0).name(), "manifest.pb");
  EXPECT_EQ(first->ingest().frame_count(), 4U);
  EXPECT_EQ(first->ingest().width_px(), 96U);
  ASSERT_EQ(first->ingest().spans_size(), 1);
  v1::SortieManifest manifest;
  ASSERT_TRUE(ReadProtoArtefact(*store, first->outputs(0), &manifest).ok());
  EXPECT_EQ(manifest.frames_size(), 4);
  EXPECT_EQ(manifest.notes_size(), first->notes_size());
  const auto second = RunIngestTask(spec, context);
  ASSERT_TRUE(second.ok());
  EXPECT_EQ(SerializeDeterministic(*first), SerializeDeterministic(*second));
}

TEST(IngestTask, RefusesACrsOfNoUseBeforeItReadsTheSource) {
  const testing::TempDir folder;
  const auto store = ArtefactStore::Open(folder / "store");
  ASSERT_TRUE(store.ok());
  TaskContext context;
  context.store = &*store;
  context.progress = [](double) { return true; };
  for (const std::string crs : {"EPSG:4326", "EPSG:123456789"}) {
    v1::TaskSpec spec;
    spec.set_kind(v1::INGEST);
    spec.mutable_sortie()->mutable_source()->set_path((folder / "not-there").string());
    spec.mutable_sortie()->mutable_mosaic()->set_crs(crs);
    const auto result = RunIngestTask(spec, context);
    ASSERT_FALSE(result.ok());
    EXPECT_EQ(result.status().code(), StatusCode::kInvalidInput);
    EXPECT_NE(result.status().message().find("mosaic.crs"), std::string::npos) << result.status().message();
    EXPECT_NE(result.status().message().find(crs), std::string::npos) << result.status().message();
  }
}

}  // namespace
}  // namespace trem
