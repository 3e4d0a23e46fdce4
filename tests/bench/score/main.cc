// trem_score: how good is a mosaic of a simulated sortie?
//
// Question: does the mosaic cover what was seen, at the right place, undistorted, and with more detail than a single frame shows?
// Baseline: the bicubic interpolation of the nearest single frame, placed by its true pose with its true gain and offset.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <string>

#include "tests/bench/score/score.h"

int main(int argc, char** argv) {
  std::string simulation;
  std::string mosaic;
  std::string picture;
  bool json = false;
  trem::score::ScoreOptions options;
  CLI::App app("Scores a mosaic against the truth of the simulation it was made from.", "trem_score");
  app.add_option("--simulation", simulation, "Folder that trem simulate made")->required();
  app.add_option("--mosaic", mosaic, "Mosaic (GeoTIFF in the truth's CRS)")->required();
  app.add_option("--picture", picture, "Write truth | bicubic | mosaic at the most detailed places");
  app.add_option("--patch-px", options.patch_px, "Side of a patch, sensor pixels")->check(CLI::Range(8, 512))->capture_default_str();
  app.add_option("--search-m", options.search_m,
                 "How far off the whole mosaic may be, metres; 0: 12 sensor pixels, at least 2 m + twice the GPS bias")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  app.add_flag("--json", json, "Print JSON");
  app.footer(
      "\nExample:\n  trem simulate truth.jpg -o sortie && trem run sortie/sortie.textproto -o mosaic.tif\n"
      "  trem_score --simulation sortie --mosaic mosaic.tif --picture compare.png\n");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  trem::score::Compared compared;
  const trem::Result<trem::score::Score> score = trem::score::ScoreMosaic(simulation, mosaic, options, &compared);
  trem::Status status = score.status();
  if (status.ok()) {
    fmt::print("{}{}", json ? trem::score::ToJson(*score) : trem::score::ToTable(*score), json ? "\n" : "");
    if (!picture.empty()) status = trem::score::WritePicture(compared, picture);
  }
  if (status.ok()) return 0;
  fmt::print(stderr, "trem_score: {}\n", status.message());
  return status.code() == trem::StatusCode::kInvalidInput || status.code() == trem::StatusCode::kNotFound ? 3 : 1;
}
