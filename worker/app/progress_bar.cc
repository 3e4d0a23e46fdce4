#include "worker/app/progress_bar.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace trem {

ProgressBar::ProgressBar(std::string label, bool quiet) : label_(std::move(label)), on_(!quiet && isatty(STDERR_FILENO) != 0) {}

ProgressBar::~ProgressBar() {
  if (!on_) return;
  fmt::print(stderr, "\r{:{}}\r", "", label_.size() + 50);
  std::fflush(stderr);
}

void ProgressBar::Show(double fraction) {
  const int percent = std::clamp(static_cast<int>(100.0 * fraction), 0, 100);
  if (!on_ || percent == shown_percent_) return;
  shown_percent_ = percent;
  fmt::print(stderr, "\r{} [{:<40}] {:3} %", label_, std::string(static_cast<std::size_t>(percent * 40 / 100), '#'), percent);
  std::fflush(stderr);
}

}  // namespace trem
