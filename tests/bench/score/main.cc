// trem_score: how good is a mosaic of a simulated sortie?
//
// Question: does the mosaic cover what was seen, at the right place, undistorted, and with more detail than a single frame shows?
// Baseline: the bicubic interpolation of the nearest single frame, placed by its true pose with its true gain and offset.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <optional>
#include <string>

#include "tests/bench/score/score.h"

namespace {

struct Arguments {
  std::string simulation;
  std::string mosaic;
  std::string picture;
  std::string work;
  bool substitutes = false;
  bool json = false;
  trem::score::ScoreOptions options;
};

trem::Status Run(const Arguments& arguments) {
  trem::score::Compared compared;
  TREM_ASSIGN_OR_RETURN(const trem::score::Score score,
                        trem::score::ScoreMosaic(arguments.simulation, arguments.mosaic, arguments.options, &compared));
  std::optional<trem::score::Substitution> substitution;
  if (!arguments.work.empty()) {
    TREM_ASSIGN_OR_RETURN(substitution, trem::score::CompareSubstitutes(arguments.simulation, arguments.work, arguments.substitutes));
  }
  if (arguments.json) {
    fmt::print("{}\n", trem::score::ToJson(score, substitution ? &*substitution : nullptr));
  } else {
    fmt::print("{}{}", trem::score::ToTable(score), substitution ? trem::score::ToTable(*substitution) : "");
  }
  if (arguments.picture.empty()) return {};
  return trem::score::WritePicture(compared, arguments.picture);
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Scores a mosaic against the truth of the simulation it was made from.", "trem_score");
  app.add_option("--simulation", arguments.simulation, "Folder that trem simulate made")->required();
  app.add_option("--mosaic", arguments.mosaic, "Mosaic (GeoTIFF in the truth's CRS)")->required();
  app.add_option("--picture", arguments.picture, "Write truth | bicubic | mosaic at the most detailed places");
  app.add_option("--work", arguments.work, "Folder of the run (trem run --keep-work): compose its scenes again at their true places");
  app.add_flag("--substitutes", arguments.substitutes, "With --work: put other things right, too, to see where quality is lost");
  app.add_option("--patch-px", arguments.options.patch_px, "Side of a patch, sensor pixels")->check(CLI::Range(8, 512))->capture_default_str();
  app.add_option("--search-m", arguments.options.search_m,
                 "How far off the whole mosaic may be, metres; 0: 12 sensor pixels, at least 2 m + twice the GPS bias")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  app.add_flag("--json", arguments.json, "Print JSON");
  app.footer(
      "\nExample:\n  trem simulate truth.jpg -o sortie && trem run sortie/sortie.textproto -o mosaic.tif\n"
      "  trem_score --simulation sortie --mosaic mosaic.tif --picture compare.png\n");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const trem::Status status = Run(arguments);
  if (status.ok()) return 0;
  fmt::print(stderr, "trem_score: {}\n", status.message());
  return status.code() == trem::StatusCode::kInvalidInput || status.code() == trem::StatusCode::kNotFound ? 3 : 1;
}
