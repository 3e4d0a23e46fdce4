#pragma once

#include <chrono>
#include <optional>
#include <string>

#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// "enhance 12/40": the stage that a job is in, and its tasks.
std::string StageText(const v1::JobStatus& job);
// "1:20 left (1:05 to 1:50)": the interval holds the truth with a probability of about 80 %. Empty when it is not known.
std::string TimeLeftText(const v1::JobStatus& job);
// "43% enhance 12/40, 2 workers, about 1:20 left (1:05 to 1:50)".
std::string ProgressLine(const v1::JobStatus& job);
// "[#####.......]  43% enhance 12/40, ..." in at most `columns` characters.
std::string ProgressBar(const v1::JobStatus& job, int columns);

// Shows a job's progress on stderr: a bar that is redrawn on a terminal, otherwise a line now and then.
class ProgressDisplay {
 public:
  enum class Mode { kSilent, kLines, kBar };
  // Bar or lines, as stderr is; silent when `quiet`.
  static Mode ModeFor(bool quiet);

  explicit ProgressDisplay(Mode mode) : mode_(mode) {}
  ~ProgressDisplay() { Clear(); }
  ProgressDisplay(const ProgressDisplay&) = delete;
  ProgressDisplay& operator=(const ProgressDisplay&) = delete;

  void Show(const v1::JobStatus& job);
  // Takes the bar away, so that something else can be printed.
  void Clear();

 private:
  using Clock = std::chrono::steady_clock;

  Mode mode_;
  bool bar_is_shown_ = false;
  std::string last_;
  std::optional<Clock::time_point> last_shown_;
};

}  // namespace trem
