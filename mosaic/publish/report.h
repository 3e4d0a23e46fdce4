#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "mosaic/publish/line_chart.h"
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

// One place of the ground as three makers show it, all on the mosaic's grid and in the same stretch of grey.
struct ReportCrop {
  std::string place;         // Where it is, for people.
  std::string frame;         // Name of the frame that was enlarged.
  std::string frame_png;     // One frame, enlarged bicubically; empty: no frame could be read.
  std::string baseline_png;  // Median of frames placed by image motion alone, at the sensor's resolution, enlarged; may be empty.
  std::string mosaic_png;
};

// What lies over the preview on the map, in mosaic pixels; the pixel centres are whole numbers.
struct ReportMap {
  std::vector<std::vector<Eigen::Vector2d>> footprints;  // Of scenes.
  std::uint32_t footprint_count = 0;                     // Of all scenes: when there are many, only some are drawn.
  // Ground points of the image centres, frame after frame; a track ends where a frame is missing.
  std::vector<std::vector<Eigen::Vector2d>> tracks;
  std::vector<std::pair<std::string, std::string>> corners;  // Corner of the mosaic, its coordinates.
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
  ReportPicture sigma;
  double grey_range = 0.0;  // Of the preview's stretch, grey levels of the source: what the spread is compared with.
  std::string estimator;    // In words.
  bool baseline_written = false;
  std::uint32_t hole_count = 0;
  ReportMap map;
  std::vector<ReportCrop> crops;
  std::vector<LineChart> charts;  // Over the frames; those without a finite value are left out.
};

// One line of the report's verdict.
struct ReportCheck {
  enum class Verdict { kGood, kLook, kBad };
  std::string name;
  std::string value;
  Verdict verdict = Verdict::kGood;
  std::string reason;  // Why it matters, and what the bounds are.
};

// What of the data speaks for the mosaic and what against it, by bounds that the reasons state.
std::vector<ReportCheck> JudgeMosaic(const ReportData& data);

// Stands in the page where a program that knows them puts the job's times: artefacts hold none, so that they stay the same.
inline constexpr const char* kReportTimesMark = "<!-- times -->";

// A self-contained page: no scripts, no references to other files; pictures inline. Valid HTML 5, UTF-8. Same data, same bytes, whatever
// the number of threads, on which its charts are drawn.
Result<std::string> RenderReport(const ReportData& data, int threads = 1);

// The start of such a page up to and with <body>, with the styles that the reports share.
std::string HtmlPageStart(const std::string& title);

// `text` with & < > " ' replaced by entities, and control characters by spaces.
std::string HtmlEscaped(const std::string& text);

}  // namespace trem
