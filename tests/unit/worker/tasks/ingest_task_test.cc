// Goal: the INGEST task stores a manifest that reads back, tells the planner what it needs, and gives the same artefact twice. Method: a
// small folder of images and a store in a temporary folder.
#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/imgcodecs.hpp>

#include "proto/codec/convert.h"
#include "tests/support/paths.h"
#include "tests/unit/worker/sortie/test_video.h"
#include "worker/sortie/frame_reader.h"
#include "worker/tasks/task.h"

namespace trem {
namespace {

// Pictures of one ground that moves evenly.
void WriteFrames(const std::filesystem::path& folder, int count, std::uint64_t seed) {
  std::filesystem::create_directories(folder);
  for (int i = 0; i < count; ++i) {
    const Image<float> frame = testing::TexturedFrame(96, 64, 2.0 * i, 1.0 * i, seed);
    cv::Mat pixels(64, 96, CV_8U);
    for (int p = 0; p < 96 * 64; ++p) pixels.data[p] = static_cast<std::uint8_t>(frame.pixels()[static_cast<std::size_t>(p)]);
    ASSERT_TRUE(cv::imwrite((folder / std::to_string(i)).string() + ".png", pixels));
  }
}

TEST(IngestTask, StoresTheSameManifestTwice) {
  const testing::TempDir folder;
  WriteFrames(folder / "frames", 4, 1);
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
  ASSERT_EQ(first->outputs_size(), 2);
  EXPECT_EQ(first->outputs(1).name(), "recording.pb");
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

// Two recordings in one sortie: frames and spans one after the other, and a manifest for each recording's windows, of which the first is
// that of the first recording alone.
TEST(IngestTask, PutsRecordingsOneAfterTheOther) {
  const testing::TempDir folder;
  const auto store = ArtefactStore::Open(folder / "store");
  ASSERT_TRUE(store.ok());
  for (const std::string name : {"first", "second"}) {
    WriteFrames(folder / name, 5, name == "first" ? 1 : 2);
  }
  TaskContext context;
  context.store = &*store;
  context.progress = [](double) { return true; };
  v1::TaskSpec spec;
  spec.set_kind(v1::INGEST);
  spec.mutable_sortie()->mutable_source()->set_path((folder / "first").string());
  const auto alone = RunIngestTask(spec, context);
  spec.mutable_sortie()->add_more()->mutable_source()->set_path((folder / "second").string());
  const auto both = RunIngestTask(spec, context);
  ASSERT_TRUE(alone.ok() && both.ok()) << both.status().message();
  ASSERT_EQ(both->outputs_size(), 3);
  EXPECT_EQ(both->outputs(1).sha256(), alone->outputs(1).sha256()) << "the windows of the first recording must keep their keys";
  EXPECT_EQ(both->ingest().frame_count(), 10U);
  ASSERT_EQ(both->ingest().recording_begins_size(), 2);
  EXPECT_EQ(both->ingest().recording_begins(1), 5U);
  v1::SortieManifest all, part;
  ASSERT_TRUE(ReadProtoArtefact(*store, both->outputs(0), &all).ok());
  ASSERT_TRUE(ReadProtoArtefact(*store, both->outputs(2), &part).ok());
  EXPECT_EQ(all.spans(all.spans_size() - 1).end(), 10U);
  // A frame has one index in both, and the same pixels.
  ASSERT_EQ(part.frames_size(), all.frames_size());
  const auto from_all = OpenFrames(all), from_part = OpenFrames(part);
  ASSERT_TRUE(from_all.ok() && from_part.ok());
  for (const int index : {5, 9}) {
    EXPECT_EQ(part.frames(index).name(), all.frames(index).name());
    const auto a = (*from_all)->Read(index), b = (*from_part)->Read(index);
    ASSERT_TRUE(a.ok() && b.ok()) << a.status().message() << b.status().message();
    EXPECT_TRUE(std::equal(a->pixels().begin(), a->pixels().end(), b->pixels().begin()));
  }
  EXPECT_FALSE((*from_part)->Read(2).ok()) << "a frame of the recording before";
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
