#include "worker/telemetry/text_scan.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <chrono>
#include <cmath>
#include <numbers>

#include "mosaic/base/check.h"

namespace trem {
namespace {

bool IsWord(char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; }

std::size_t SkipBlanks(std::string_view text, std::size_t at) {
  while (at < text.size() && (text[at] == ' ' || text[at] == '\t')) ++at;
  return at;
}

// `count` digits at `at`; -1: there are none.
int Digits(std::string_view text, std::size_t at, std::size_t count) {
  if (at + count > text.size()) return -1;
  int value = 0;
  for (std::size_t i = at; i < at + count; ++i) {
    if (text[i] < '0' || text[i] > '9') return -1;
    value = 10 * value + (text[i] - '0');
  }
  return value;
}

// "Z", "+hh:mm", "-hhmm" or nothing, in seconds east of Greenwich.
std::optional<int> ZoneOffset(std::string_view zone) {
  if (zone.empty() || zone == "Z" || zone == "z") return 0;
  if (zone[0] != '+' && zone[0] != '-') return std::nullopt;
  const int hours = Digits(zone, 1, 2);
  const bool colon = zone.size() > 3 && zone[3] == ':';
  const int minutes = zone.size() == 3 ? 0 : Digits(zone, colon ? 4 : 3, 2);
  if (hours < 0 || hours > 14 || minutes < 0 || minutes > 59 || zone.size() > 6) return std::nullopt;
  return (zone[0] == '-' ? -1 : 1) * (hours * 3600 + minutes * 60);
}

}  // namespace

std::optional<double> ParseDecimal(std::string_view text) {
  std::size_t begin = SkipBlanks(text, 0);
  if (begin < text.size() && text[begin] == '+') ++begin;
  double value = 0.0;
  const auto parsed = std::from_chars(text.data() + begin, text.data() + text.size(), value);
  if (parsed.ec != std::errc() || !std::isfinite(value)) return std::nullopt;
  const auto end = static_cast<std::size_t>(parsed.ptr - text.data());
  return SkipBlanks(text, end) == text.size() ? std::optional<double>(value) : std::nullopt;
}

std::optional<double> NumberAfter(std::string_view text, std::string_view key) {
  for (std::size_t at = text.find(key); at != std::string_view::npos; at = text.find(key, at + 1)) {
    if (at > 0 && IsWord(text[at - 1])) continue;
    std::size_t next = SkipBlanks(text, at + key.size());
    if (next >= text.size() || text[next] != ':') continue;
    next = SkipBlanks(text, next + 1);
    if (next < text.size() && text[next] == '+') ++next;
    double value = 0.0;
    const auto parsed = std::from_chars(text.data() + next, text.data() + text.size(), value);
    if (parsed.ec == std::errc() && std::isfinite(value)) return value;
  }
  return std::nullopt;
}

std::optional<std::int64_t> ParseTimeUtc(std::string_view text) {
  if (text.size() < 19 || text.size() > 40) return std::nullopt;
  if ((text[4] != '-' && text[4] != ':') || text[7] != text[4] || (text[10] != 'T' && text[10] != ' ')) return std::nullopt;
  if (text[13] != ':' || text[16] != ':') return std::nullopt;
  const int year = Digits(text, 0, 4);
  const int month = Digits(text, 5, 2);
  const int day = Digits(text, 8, 2);
  const int hour = Digits(text, 11, 2);
  const int minute = Digits(text, 14, 2);
  const int second = Digits(text, 17, 2);
  if (year < 1970 || month < 0 || day < 0 || hour < 0 || hour > 23 || minute < 0 || minute > 59 || second < 0 || second > 60)
    return std::nullopt;
  const std::chrono::year_month_day date{std::chrono::year(year), std::chrono::month(static_cast<unsigned>(month)),
                                         std::chrono::day(static_cast<unsigned>(day))};
  if (!date.ok()) return std::nullopt;
  std::size_t at = 19;
  std::int64_t micros = 0;
  if (at < text.size() && (text[at] == '.' || text[at] == ',')) {
    std::int64_t unit = 100'000;
    for (++at; at < text.size() && text[at] >= '0' && text[at] <= '9'; ++at, unit /= 10) micros += unit * (text[at] - '0');
  }
  const std::optional<int> zone_s = ZoneOffset(text.substr(at));
  if (!zone_s.has_value()) return std::nullopt;
  const std::int64_t days = std::chrono::sys_days(date).time_since_epoch().count();
  return ((days * 24 + hour) * 60 + minute) * 60'000'000LL + (second - *zone_s) * 1'000'000LL + micros;
}

double HfovOfFocal35(double focal_mm, double aspect) {
  TREM_CHECK(focal_mm > 0.0 && aspect > 0.0);
  constexpr double kDiagonal_mm = 43.2666;
  const double sensor_aspect = aspect > 1.52 ? 4.0 / 3.0 : aspect;
  const double half_width_mm = 0.5 * kDiagonal_mm * sensor_aspect / std::hypot(sensor_aspect, 1.0);
  return 2.0 * std::atan(half_width_mm / focal_mm) * 180.0 / std::numbers::pi;
}

}  // namespace trem
