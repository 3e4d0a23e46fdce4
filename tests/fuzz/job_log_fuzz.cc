// Goal: a log of a job that somebody has edited, or that a crash has cut, breaks neither its reader nor the message it is sent in. Method:
// the bytes as a job's log file; the page made of it must be a valid envelope of printable text.
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "coordinator/store/job_log.h"
#include "mosaic/base/check.h"
#include "proto/codec/envelope.h"
#include "tests/fuzz/scratch_folder.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const std::filesystem::path folder = trem::fuzz::MakeScratchFolder();
  std::ofstream(folder / "job.log", std::ios::binary).write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  trem::JobLog log(folder);
  trem::v1::LogLine line;
  line.set_text(std::string(reinterpret_cast<const char*>(data), size));
  log.Append("job", line);
  trem::v1::GetLog get;
  get.set_job_id("job");
  trem::v1::Envelope envelope;
  *envelope.mutable_log_page() = log.Page(get);
  TREM_CHECK(envelope.log_page().is_last() || envelope.log_page().lines_size() > 0);
  const trem::EnvelopeFrames frames = trem::EncodeEnvelope(envelope);
  TREM_CHECK(trem::DecodeEnvelope(frames.header, frames.body).ok());
  for (const trem::v1::LogLine& out : envelope.log_page().lines()) {
    for (const char c : out.text()) TREM_CHECK(static_cast<unsigned char>(c) >= 0x20 && c != 0x7f);
  }
  return 0;
}
