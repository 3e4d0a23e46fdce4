#include "worker/registration/view_chart.h"

namespace trem {

View ViewChart::At(const HintsState& x) const {
  const CornerVector d = basis * x.head(basis.cols());
  return {Displace(centre.scene_from_sensor, roi, d), centre.gain, centre.offset};
}

ViewChart FullChart(const ViewPrior& prior, const Roi& roi) {
  const Eigen::Index n = prior.information.rows();
  return {prior.mean, roi, HintsMatrix::Identity(n, n)};
}

ViewChart SimilarityChart(const ViewPrior& prior, const Roi& roi) {
  const Eigen::Index n = prior.information.rows();
  HintsMatrix basis(n, 4);
  const Eigen::Vector2d half(0.5 * (roi.width() - 1), 0.5 * (roi.height() - 1));
  const double radius = std::max(half.norm(), 0.5);
  for (Eigen::Index corner = 0; corner < n / 2; ++corner) {
    const Eigen::Vector2d arm(corner % 2 == 0 ? -half.x() : half.x(), corner / 2 == 0 ? -half.y() : half.y());
    basis.block<2, 2>(2 * corner, 0).setIdentity();
    basis.block<2, 1>(2 * corner, 2) = Eigen::Vector2d(-arm.y(), arm.x()) / radius;
    basis.block<2, 1>(2 * corner, 3) = arm / radius;
  }
  return {prior.mean, roi, basis};
}

}  // namespace trem
