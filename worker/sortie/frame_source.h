#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/sortie/grey_image.h"

namespace trem {

// One frame on its way through ingest.
struct SourceFrame {
  std::string name;         // As in ManifestFrame.
  std::string path;         // What messages call its file.
  std::int64_t number = 0;  // In the source, counted from 0, whatever source.first_frame says.
  std::int64_t pts = 0;
  double time_s = 0.0;
  std::function<Result<GreyImage>()> read;  // Gives its pixels; from any thread, as long as the source lives.
};

// A sortie's frames, once, in order, one at a time.
class FrameSource {
 public:
  virtual ~FrameSource() = default;

  // False at the end (of the source, or after source.max_frames). Of a video the frame is decoded here.
  virtual Result<bool> Next(SourceFrame* frame) = 0;
  // Frames that Next will give, as far as that is known; 0: unknown.
  virtual std::int64_t expected_count() const = 0;
  // Size that most frames have.
  virtual int width_px() const = 0;
  virtual int height_px() const = 0;
  virtual v1::SourceKind kind() const = 0;
  virtual bool deinterlaced() const { return false; }
  // What is worth knowing about the source as a whole; complete after Next returned false.
  virtual std::vector<v1::Note> notes() const { return {}; }
};

// Opens sortie.source. Same errors as ListImages and VideoStream::Open; kInvalidInput when source.first_frame lies behind the end.
Result<std::unique_ptr<FrameSource>> OpenFrameSource(const v1::Sortie& sortie);

v1::Note MakeNote(v1::Severity severity, const std::string& code, const std::string& subject, const std::string& message);

}  // namespace trem
