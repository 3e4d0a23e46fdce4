#include "coordinator/cli/progress.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "coordinator/cli/job_report.h"
#include "coordinator/cli/terminal.h"

namespace trem {
namespace {

constexpr std::chrono::seconds kLineInterval{3};

double Fraction(const v1::JobStatus& job) { return std::isfinite(job.fraction()) ? std::clamp(job.fraction(), 0.0, 1.0) : 0.0; }

// Rounded down: 100% means done.
int Percent(const v1::JobStatus& job) { return static_cast<int>(std::floor(Fraction(job) * 100.0 + 1e-9)); }

std::string Details(const v1::JobStatus& job) {
  std::string text = StageText(job);
  text += fmt::format(", {} worker{}", job.worker_count(), job.worker_count() == 1 ? "" : "s");
  if (const std::string left = TimeLeftText(job); !left.empty()) text += ", about " + left;
  return text;
}

}  // namespace

std::string StageText(const v1::JobStatus& job) {
  if (job.state() != v1::JOB_RUNNING) return JobStateName(job.state());
  const v1::StageStatus* current = nullptr;
  for (const v1::StageStatus& stage : job.stages()) {
    if (stage.total() == 0) continue;
    current = &stage;
    if (stage.done() < stage.total()) break;
  }
  if (current == nullptr) return "waiting";
  return fmt::format("{} {}/{}", TaskKindName(current->kind()), current->done(), current->total());
}

std::string TimeLeftText(const v1::JobStatus& job) {
  if (job.state() != v1::JOB_RUNNING || job.eta_s() <= 0) return "";
  const std::string text = FormatDuration(job.eta_s()) + " left";
  if (job.eta_high_s() <= job.eta_low_s()) return text;
  return text + " (" + FormatDuration(job.eta_low_s()) + " to " + FormatDuration(job.eta_high_s()) + ")";
}

std::string ProgressLine(const v1::JobStatus& job) { return fmt::format("{:3}% {}", Percent(job), Details(job)); }

std::string ProgressBar(const v1::JobStatus& job, int columns) {
  const std::string line = ProgressLine(job);
  const int room = columns - static_cast<int>(line.size()) - 4;
  if (room < 8) return line.substr(0, static_cast<std::size_t>(std::max(0, columns)));
  const auto width = static_cast<std::size_t>(std::min(room, 30));
  const auto filled = static_cast<std::size_t>(std::floor(Fraction(job) * static_cast<double>(width)));
  return "[" + std::string(filled, '#') + std::string(width - filled, '.') + "] " + line;
}

ProgressDisplay::Mode ProgressDisplay::ModeFor(bool quiet) {
  if (quiet) return Mode::kSilent;
  return StderrIsTerminal() ? Mode::kBar : Mode::kLines;
}

void ProgressDisplay::Show(const v1::JobStatus& job) {
  if (mode_ == Mode::kSilent) return;
  if (mode_ == Mode::kBar) {
    fmt::print(stderr, "\r\x1b[K{}", ProgressBar(job, StderrColumns() - 1));
    std::fflush(stderr);
    bar_is_shown_ = true;
    return;
  }
  const auto now = Clock::now();
  const std::string line = ProgressLine(job);
  if (line == last_ || (last_shown_ && now - *last_shown_ < kLineInterval)) return;
  last_ = line;
  last_shown_ = now;
  fmt::print(stderr, "{}\n", line);
}

void ProgressDisplay::Clear() {
  if (!bar_is_shown_) return;
  fmt::print(stderr, "\r\x1b[K");
  std::fflush(stderr);
  bar_is_shown_ = false;
}

}  // namespace trem
