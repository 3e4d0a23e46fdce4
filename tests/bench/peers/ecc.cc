#include "tests/bench/peers/ecc.h"

#include <opencv2/core.hpp>
#include <opencv2/video/tracking.hpp>

#include "tests/bench/cpu_clock.h"

namespace trem::bench {
namespace {

cv::Mat MatOf(const Image<float>& image) { return {image.height(), image.width(), CV_32F, const_cast<float*>(image.row(0))}; }

}  // namespace

EccAnswer RegisterEcc(const FrameInput& before, const FrameInput& now, const EccSettings& settings) {
  const Affine start = now.previous_from_current.value_or(Affine{});
  // The warp takes points of the template (now) to points of the input (before).
  cv::Mat warp = (cv::Mat_<float>(2, 3) << start.linear(0, 0), start.linear(0, 1), start.offset.x(), start.linear(1, 0), start.linear(1, 1),
                  start.offset.y());
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, settings.iterations_max, settings.eps);
  const double begin = ThreadCpuMs();
  EccAnswer answer;
  answer.previous_from_current = start;
  try {
    cv::findTransformECC(MatOf(now.pixels), MatOf(before.pixels), warp, cv::MOTION_AFFINE, criteria, cv::noArray(), settings.smoothing_px);
  } catch (const cv::Exception&) {
    return answer;
  }
  answer.seconds = 1e-3 * (ThreadCpuMs() - begin);
  answer.previous_from_current.linear << warp.at<float>(0, 0), warp.at<float>(0, 1), warp.at<float>(1, 0), warp.at<float>(1, 1);
  answer.previous_from_current.offset << warp.at<float>(0, 2), warp.at<float>(1, 2);
  return answer;
}

}  // namespace trem::bench
