#pragma once

#include <string>

namespace trem {

// A bar on stderr where somebody watches; nothing elsewhere. Clears its line when it dies.
class ProgressBar {
 public:
  ProgressBar(std::string label, bool quiet);
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  // `fraction` done, 0..1.
  void Show(double fraction);

 private:
  std::string label_;
  bool on_;
  int shown_percent_ = -1;
};

}  // namespace trem
