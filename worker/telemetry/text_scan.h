#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace trem {

// The number that follows `key` and a colon (blanks allowed) in `text`, where `key` begins a word: "[rel_alt: 1.30 abs_alt: 39.4]". The
// first finite one; nothing when there is none.
std::optional<double> NumberAfter(std::string_view text, std::string_view key);

// A finite number that fills `text`, blanks around it and a plus sign allowed.
std::optional<double> ParseDecimal(std::string_view text);

// Microseconds since 1970-01-01 UTC of "2019-04-18T14:34:10.567Z" (ISO 8601; T or a blank; a fraction, Z or +hh:mm may be missing, without
// a zone it counts as UTC) and of EXIF's "2019:04:18 14:34:10". Nothing for anything else, or a date that is none.
std::optional<std::int64_t> ParseTimeUtc(std::string_view text);

// Horizontal field of view [degrees] of a lens whose 35 mm equivalent focal length is `focal_mm`: its image circle has the 43.27 mm
// diagonal of 36 x 24 mm (CIPA DCG-001). `aspect`: width over height of the image; one wider than 3:2 counts as cut from a 4:3 sensor of
// the same width, as cameras with such pictures mostly have. Precondition: both positive.
double HfovOfFocal35(double focal_mm, double aspect);

}  // namespace trem
