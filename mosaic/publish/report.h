#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "mosaic/publish/picture.h"

namespace trem {

struct ReportNote {
  bool warning = false;
  std::string code;
  std::string subject;
  std::string message;
};

struct ReportFrame {
  std::string name;
  std::string status;
  std::string reason;
};

// A picture with its legend; an empty `png` is left out of the report.
struct ReportPicture {
  std::string png;   // Bytes of the file.
  ValueRange range;  // What its darkest and brightest colours stand for.
};

// Everything mosaic_report.html tells. Texts are plain: the report escapes them.
struct ReportData {
  std::string sortie;
  std::string source;
  std::string software;
  bool georeferenced = false;
  std::string crs_name;
  std::string gauge;
  int width = 0;
  int height = 0;
  double gsd = 0.0;  // Metres, or sensor pixels when not georeferenced.
  std::uint32_t frame_count = 0;
  std::uint32_t registered_count = 0;
  std::uint32_t skipped_count = 0;   // Not usable: unreadable, blank, repeated.
  std::uint32_t lost_count = 0;      // Usable, but no window could register them.
  std::uint32_t not_used_count = 0;  // Usable, in no window.
  std::uint32_t window_count = 0;
  std::uint32_t scene_count = 0;
  std::uint32_t piece_count = 0;
  double tie_rms_px = 0.0;
  double coverage = 0.0;                    // Part of the mosaic's rectangle that some scene covers.
  double median_scenes = 0.0;               // Medians over the covered ground.
  double median_nmad = 0.0;                 // Grey levels of the source; NaN when unknown.
  double median_position_sigma = 0.0;       // CRS units; NaN when unknown.
  std::vector<ReportFrame> missing_frames;  // The first ones; missing_frame_count counts all.
  std::uint32_t missing_frame_count = 0;
  std::vector<ReportNote> notes;
  ReportPicture preview;
  ReportPicture count;
  ReportPicture nmad;
};

// A self-contained page: no scripts, no references to other files; pictures inline. Valid HTML 5, UTF-8. Same data, same bytes.
std::string RenderReport(const ReportData& data);

// The start of such a page up to and with <body>, with the styles that the reports share.
std::string HtmlPageStart(const std::string& title);

// `text` with & < > " ' replaced by entities, and control characters by spaces.
std::string HtmlEscaped(const std::string& text);

}  // namespace trem
