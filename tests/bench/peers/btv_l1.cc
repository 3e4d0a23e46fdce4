#include "tests/bench/peers/btv_l1.h"

#include <algorithm>
#include <cmath>
#include <opencv2/superres.hpp>

#include "tests/bench/cpu_clock.h"

namespace trem::bench {
namespace {

// The library enlarges radius + 1 frames at its start and, while it reads frame 2 radius + 1, is about to enlarge frame radius + 1. That
// one is wanted: it alone gets all its iterations, the others one each, which makes no difference to it.
class Frames : public cv::superres::FrameSource {
 public:
  Frames(std::vector<cv::Mat> frames, const BtvSettings& settings, cv::superres::SuperResolution* method)
      : frames_(std::move(frames)), settings_(settings), method_(method) {}

  void nextFrame(cv::OutputArray frame) override {
    const auto last = static_cast<std::size_t>(2 * settings_.radius + 1);
    if (next_ >= frames_.size()) {
      frame.release();
      return;
    }
    if (next_ == last) {
      method_->setIterations(settings_.iterations);
      wanted_from_ = ThreadCpuMs();
    }
    frames_[next_++].copyTo(frame);
  }
  void reset() override { next_ = 0; }
  double wanted_from() const { return wanted_from_; }

 private:
  std::vector<cv::Mat> frames_;
  BtvSettings settings_;
  cv::superres::SuperResolution* method_;
  std::size_t next_ = 0;
  double wanted_from_ = 0.0;
};

cv::Mat Bytes(const Image<float>& frame) {
  const cv::Mat view(frame.height(), frame.width(), CV_32F, const_cast<float*>(frame.row(0)));
  cv::Mat grey;
  view.convertTo(grey, CV_8U);  // The library's optical flow wants bytes.
  return grey;
}

// One frame that is only there to be first, `radius` frames, frame 0, `radius` frames.
std::vector<cv::Mat> Chain(const BenchScene& scene, int radius) {
  TREM_CHECK(scene.options.frame_count >= 2 * radius + 1);
  std::vector<cv::Mat> frames;
  for (int k = radius; k > 0; --k) frames.push_back(Bytes(scene.Flattened(2 * k)));
  frames.insert(frames.begin(), frames.front());
  frames.push_back(Bytes(scene.Flattened(0)));
  for (int k = 0; k < radius; ++k) frames.push_back(Bytes(scene.Flattened(2 * k + 1)));
  return frames;
}

}  // namespace

BtvAnswer RunBtv(const BenchScene& scene, const BtvSettings& settings) {
  const PsfParameters psf = scene.psf();
  const double sigma = settings.blur_factor * BenchScene::kRatio * std::hypot(psf.sigma_px, psf.fill_factor / std::sqrt(12.0));
  const cv::Ptr<cv::superres::SuperResolution> method = cv::superres::createSuperResolution_BTVL1();
  method->setScale(BenchScene::kRatio);
  method->setTemporalAreaRadius(settings.radius);
  method->setIterations(1);
  method->setLambda(settings.lambda);
  method->setAlpha(settings.alpha);
  method->setTau(settings.tau);
  method->setBlurKernelSize(2 * static_cast<int>(std::ceil(3.0 * sigma)) + 1);
  method->setBlurSigma(sigma);
  const auto source = cv::makePtr<Frames>(Chain(scene, settings.radius), settings, method.get());
  method->setInput(source);
  cv::Mat enlarged;
  method->nextFrame(enlarged);
  BtvAnswer result;
  result.seconds = 1e-3 * (ThreadCpuMs() - source->wanted_from());
  for (int k = 0; k < settings.radius + 1; ++k) method->nextFrame(enlarged);
  // The library cuts a border as wide as its regulariser's kernel.
  const int cut = (scene.AnswerSide() - enlarged.cols) / 2;
  cv::Mat framed;
  cv::copyMakeBorder(enlarged, framed, cut, cut, cut, cut, cv::BORDER_REPLICATE);
  framed.convertTo(framed, CV_32F);
  TREM_CHECK(framed.cols == scene.AnswerSide());
  result.answer = Image<float>(framed.cols, framed.rows);
  for (int y = 0; y < framed.rows; ++y) std::copy_n(framed.ptr<float>(y), framed.cols, result.answer.row(y));
  return result;
}

}  // namespace trem::bench
