#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "mosaic/align/align.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/tasks/align_input.h"

namespace trem {

// What the windows say became of the sortie's usable frames.
struct FrameCensus {
  std::uint32_t registered = 0;                       // In at least one window.
  std::map<std::uint32_t, std::string> lost;          // In no window; the most frequent reason.
  std::map<std::string, std::uint32_t> lost_in_part;  // Reason -> (frame, window) pairs, of frames that another window has registered.
};

FrameCensus CountFrames(const v1::SortieManifest& manifest, const std::vector<v1::WindowResult>& windows);

// Why there is no mosaic, and what to try.
std::string NothingEnhancedText(const FrameCensus& census);

// Everything a user should know of the alignment, sorted by code and subject.
std::vector<v1::Note> AlignNotes(const v1::Sortie& sortie, const v1::SortieManifest& manifest, const FrameCensus& census,
                                 const AlignTaskInput& input, const align::AlignSolution& solution);

}  // namespace trem
