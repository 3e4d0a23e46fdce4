#include "worker/sortie/frame_reader.h"

#include <charconv>
#include <string>
#include <vector>

#include "worker/sortie/image_sequence_reader.h"
#include "worker/sortie/video_reader.h"

namespace trem {
namespace {

Status CheckIndex(const v1::SortieManifest& manifest, int index) {
  if (index >= 0 && index < manifest.frames_size()) return {};
  return InvalidInput(manifest.source_path() + ": frame " + std::to_string(index) + " was asked for; the manifest has frames 0 to " +
                      std::to_string(manifest.frames_size() - 1));
}

Result<Image<float>> CheckSize(const v1::SortieManifest& manifest, const std::string& subject, GreyImage image) {
  if (image.pixels.width() == static_cast<int>(manifest.width_px()) && image.pixels.height() == static_cast<int>(manifest.height_px())) {
    return std::move(image.pixels);
  }
  return InvalidInput(subject + ": is " + std::to_string(image.pixels.width()) + " x " + std::to_string(image.pixels.height()) +
                      " pixels; expected " + std::to_string(manifest.width_px()) + " x " + std::to_string(manifest.height_px()) +
                      " like most frames of this sortie");
}

class ImageSequenceFrames final : public FrameReader {
 public:
  explicit ImageSequenceFrames(const v1::SortieManifest& manifest) : manifest_(manifest), folder_(ImageFolder(manifest.source_path())) {}

  Result<Image<float>> Read(int index) override {
    TREM_RETURN_IF_ERROR(CheckIndex(manifest_, index));
    const std::string subject = "frame " + std::to_string(index) + ", ";
    const std::filesystem::path path = folder_ / manifest_.frames(index).name();
    Result<GreyImage> image = ReadGreyImage(path);
    if (!image.ok()) return Status(image.status().code(), subject + image.status().message());
    return CheckSize(manifest_, subject + path.string(), std::move(image).value());
  }

 private:
  const v1::SortieManifest& manifest_;
  std::filesystem::path folder_;
};

class VideoFrames final : public FrameReader {
 public:
  VideoFrames(const v1::SortieManifest& manifest, std::unique_ptr<VideoReader> reader) : manifest_(manifest), reader_(std::move(reader)) {}

  Result<Image<float>> Read(int index) override {
    TREM_RETURN_IF_ERROR(CheckIndex(manifest_, index));
    TREM_ASSIGN_OR_RETURN(GreyImage image, reader_->Read(index));
    return CheckSize(manifest_, manifest_.source_path() + ": frame " + manifest_.frames(index).name(), std::move(image));
  }

 private:
  const v1::SortieManifest& manifest_;
  std::unique_ptr<VideoReader> reader_;
};

Result<std::unique_ptr<FrameReader>> OpenVideoFrames(const v1::SortieManifest& manifest) {
  std::vector<VideoFrameId> frames;
  frames.reserve(static_cast<std::size_t>(manifest.frames_size()));
  for (const v1::ManifestFrame& frame : manifest.frames()) {
    VideoFrameId id;
    id.pts = frame.pts();
    const std::string& name = frame.name();
    const auto parsed = std::from_chars(name.data() + 1, name.data() + name.size(), id.number);
    if (name.size() < 2 || name[0] != '#' || parsed.ec != std::errc() || parsed.ptr != name.data() + name.size() || id.number < 0) {
      return Corrupt("manifest of " + manifest.source_path() + ": frame name '" + name + "'; expected '#<number>' for video");
    }
    frames.push_back(id);
  }
  VideoReaderOptions options;
  options.deinterlace = manifest.deinterlaced();
  options.from_start = manifest.video_from_start();
  TREM_ASSIGN_OR_RETURN(std::unique_ptr<VideoReader> reader, VideoReader::Open(manifest.source_path(), std::move(frames), options));
  return std::unique_ptr<FrameReader>(std::make_unique<VideoFrames>(manifest, std::move(reader)));
}

}  // namespace

namespace {

// Frames of several recordings, each read as if it were the only one.
class RecordingFrames : public FrameReader {
 public:
  static Result<std::unique_ptr<FrameReader>> Open(const v1::SortieManifest& manifest) {
    auto frames = std::make_unique<RecordingFrames>();
    for (const v1::RecordingManifest& recording : manifest.recordings()) {
      if (recording.frame_begin() > recording.frame_end() || recording.frame_end() > static_cast<std::uint32_t>(manifest.frames_size()))
        return Corrupt("manifest of " + recording.source_path() + ": its recording has frames beyond the manifest's");
      Part part;
      part.begin = static_cast<int>(recording.frame_begin());
      part.end = static_cast<int>(recording.frame_end());
      part.manifest = std::make_unique<v1::SortieManifest>();
      part.manifest->set_source_path(recording.source_path());
      part.manifest->set_source_kind(recording.source_kind());
      part.manifest->set_width_px(manifest.width_px());
      part.manifest->set_height_px(manifest.height_px());
      part.manifest->set_deinterlaced(recording.deinterlaced());
      part.manifest->set_video_from_start(recording.video_from_start());
      for (int i = part.begin; i < part.end; ++i) *part.manifest->add_frames() = manifest.frames(i);
      frames->parts_.push_back(std::move(part));
    }
    return std::unique_ptr<FrameReader>(std::move(frames));
  }

  Result<Image<float>> Read(int index) override {
    for (Part& part : parts_) {
      if (index < part.begin || index >= part.end) continue;
      if (part.reader == nullptr) {
        TREM_ASSIGN_OR_RETURN(part.reader, OpenFrames(*part.manifest));
      }
      return part.reader->Read(index - part.begin);
    }
    return InvalidInput("frame " + std::to_string(index) + " was asked for; none of the " + std::to_string(parts_.size()) +
                        " recordings has it");
  }

 private:
  struct Part {
    int begin = 0;
    int end = 0;
    std::unique_ptr<v1::SortieManifest> manifest;  // Lent to the reader.
    std::unique_ptr<FrameReader> reader;           // Opened when it is needed.
  };
  std::vector<Part> parts_;
};

}  // namespace

Result<std::unique_ptr<FrameReader>> OpenFrames(const v1::SortieManifest& manifest) {
  if (manifest.recordings_size() > 0) return RecordingFrames::Open(manifest);
  switch (manifest.source_kind()) {
    case v1::IMAGE_SEQUENCE:
      return std::unique_ptr<FrameReader>(std::make_unique<ImageSequenceFrames>(manifest));
    case v1::VIDEO:
      return OpenVideoFrames(manifest);
    default:
      return Corrupt("manifest of " + manifest.source_path() + ": source_kind " + std::to_string(manifest.source_kind()) +
                     "; expected IMAGE_SEQUENCE or VIDEO");
  }
}

}  // namespace trem
