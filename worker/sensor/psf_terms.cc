#include "worker/sensor/psf_terms.h"

#include <Eigen/SVD>
#include <cmath>

#include "mosaic/base/check.h"

namespace trem {

Psf DecomposeKernel(const Eigen::MatrixXd& kernel) {
  TREM_CHECK(kernel.rows() == kernel.cols() && kernel.rows() % 2 == 1);
  const double mass = kernel.sum();
  TREM_CHECK(mass > 0.0);
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(kernel, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(kernel.rows(), kernel.cols());
  Eigen::Index rank = 0;
  while (rank < kernel.rows() && (rank == 0 || (kernel - sum).cwiseAbs().sum() > kDecompositionTolerance * mass)) {
    sum += svd.singularValues()(rank) * svd.matrixU().col(rank) * svd.matrixV().col(rank).transpose();
    ++rank;
  }
  Psf psf;
  for (Eigen::Index t = 0; t < rank; ++t) {
    Eigen::VectorXd row = svd.matrixV().col(t);
    Eigen::VectorXd column = svd.matrixU().col(t) * (svd.singularValues()(t) / sum.sum());
    Eigen::Index largest = 0;
    row.cwiseAbs().maxCoeff(&largest);
    if (row(largest) < 0.0) {
      row = -row;
      column = -column;
    }
    PsfTerm term;
    for (Eigen::Index i = 0; i < kernel.rows(); ++i) {
      term.row.push_back(static_cast<float>(row(i)));
      term.column.push_back(static_cast<float>(column(i)));
    }
    psf.terms.push_back(std::move(term));
  }
  psf.negative_mass = std::abs(KernelOf(psf).cwiseMin(0.0).sum());
  return psf;
}

Eigen::MatrixXd KernelOf(const Psf& psf) {
  const int radius = psf.radius();
  Eigen::MatrixXd kernel = Eigen::MatrixXd::Zero(2 * radius + 1, 2 * radius + 1);
  for (int j = -radius; j <= radius; ++j) {
    for (int i = -radius; i <= radius; ++i) {
      double& value = kernel(j + radius, i + radius);
      if (psf.is_rank_one_symmetric()) {
        value = static_cast<double>(psf.taps[static_cast<std::size_t>(std::abs(i))]) * psf.taps[static_cast<std::size_t>(std::abs(j))];
      }
      for (const PsfTerm& term : psf.terms) {
        value += static_cast<double>(term.row[static_cast<std::size_t>(i + radius)]) * term.column[static_cast<std::size_t>(j + radius)];
      }
    }
  }
  return kernel;
}

}  // namespace trem
