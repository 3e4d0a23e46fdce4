// Goal: the PSFs that are not a Gaussian times a box are what their physics says. Method: the discrete transfer function of the kernel
// against the closed form; the Airy pattern in closed form (Bessel function) with no detector to speak of; smear against explicit averaging of
// shifted kernels; decomposition against the kernel it was made from.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "mosaic/base/rng.h"
#include "tests/unit/worker/sensor/sample_psfs.h"
#include "worker/sensor/psf.h"
#include "worker/sensor/psf_spectrum.h"
#include "worker/sensor/psf_terms.h"

namespace trem {
namespace {

PsfParameters Optics(double q, double sigma_px = 0.0) {
  PsfParameters parameters;
  parameters.model = PsfModel::kOptics;
  parameters.sigma_px = sigma_px;
  parameters.q = q;
  return parameters;
}

// |transfer function| of a kernel at (fx, fy) cycles a sensor pixel.
double KernelMtf(const Eigen::MatrixXd& kernel, int ratio, double fx, double fy) {
  const int radius = static_cast<int>(kernel.rows() / 2);
  double re = 0.0;
  double im = 0.0;
  for (int j = -radius; j <= radius; ++j) {
    for (int i = -radius; i <= radius; ++i) {
      const double phase = 2.0 * std::numbers::pi * (fx * i + fy * j) / ratio;
      re += kernel(j + radius, i + radius) * std::cos(phase);
      im += kernel(j + radius, i + radius) * std::sin(phase);
    }
  }
  return std::hypot(re, im);
}

TEST(OpticsPsf, WithAPointDetectorItIsTheAiryPattern) {
  PsfParameters optics = Optics(1.0);
  optics.fill_factor = 0.001;
  const Eigen::MatrixXd samples = SampleSpectrum(optics, 3, 18);
  // h(r) = pi / 4 (2 J1(v) / v)^2 per px^2 with v = pi r / q, r in px.
  const auto airy = [](double r_px) {
    const double v = std::numbers::pi * r_px;
    const double shape = v < 1e-9 ? 1.0 : 2.0 * std::cyl_bessel_j(1.0, v) / v;
    return std::numbers::pi / 4.0 * shape * shape / 9.0;
  };
  for (int j = -18; j <= 18; ++j) {
    for (int i = -18; i <= 18; ++i) EXPECT_NEAR(samples(j + 18, i + 18), airy(std::hypot(i, j) / 3.0), 1e-5 * airy(0.0)) << i << ", " << j;
  }
}

TEST(OpticsPsf, TheKernelHasTheTransferFunctionOfApertureAndDetector) {
  for (const double q : {0.7, 1.0, 1.8}) {
    for (const double sigma_px : {0.0, 0.4}) {
      const Eigen::MatrixXd kernel = KernelOf(*MakePsf(Optics(q, sigma_px), 3));
      EXPECT_NEAR(kernel.sum(), 1.0, 1e-6);
      for (const auto& [fx, fy] : {std::pair{0.2, 0.0}, {0.0, 0.3}, {0.3, 0.25}, {0.5, 0.0}, {0.4, 0.6}, {0.8, 0.1}}) {
        // 0.03 of the mass lies in wings that are cut off, and what is left is normalised.
        EXPECT_NEAR(KernelMtf(kernel, 3, fx, fy), std::abs(TransferFunction(Optics(q, sigma_px), fx, fy)), 0.035)
            << "q " << q << ", sigma " << sigma_px << " at " << fx << ", " << fy;
      }
    }
  }
}

TEST(OpticsPsf, NothingPassesAboveTheCutOff) {
  EXPECT_EQ(DiffractionMtf(1.0), 0.0);
  EXPECT_EQ(DiffractionMtf(0.0), 1.0);
  EXPECT_NEAR(DiffractionMtf(0.5), 0.391, 5e-4) << "Goodman's table";
  EXPECT_LT(KernelMtf(KernelOf(*MakePsf(Optics(1.5), 3)), 3, 0.85, 0.0), 0.01) << "the cut-off is at 0.667 cycles/px";
}

TEST(SmearedPsf, IsTheAverageOfShiftedKernels) {
  PsfParameters smeared{0.6, 0.9};
  smeared.smear_px = 2.0;
  smeared.smear_direction_rad = std::atan2(3.0, 4.0);
  const Eigen::MatrixXd kernel = KernelOf(*MakePsf(smeared, 3));
  EXPECT_NEAR(kernel.sum(), 1.0, 1e-6);
  for (const auto& [fx, fy] : {std::pair{0.2, 0.0}, {0.0, 0.2}, {0.3, 0.1}, {0.3, -0.1}, {-0.2, 0.25}, {0.4, 0.3}}) {
    const double along = std::numbers::pi * 2.0 * (0.8 * fx + 0.6 * fy);
    const double sharp = TransferFunction({0.6, 0.9}, fx, fy);
    EXPECT_NEAR(KernelMtf(kernel, 3, fx, fy), std::abs(sharp * (std::abs(along) < 1e-9 ? 1.0 : std::sin(along) / along)), 0.004) << fx << ", " << fy;
  }
  // Longer along (4, 3) than across.
  const int r = static_cast<int>(kernel.rows() / 2);
  EXPECT_GT(kernel(r + 3, r + 4), 3.0 * kernel(r - 3, r + 4));
}

TEST(SmearedPsf, AlongAnAxisItIsOneTerm) {
  PsfParameters smeared{0.6, 0.9};
  smeared.smear_px = 1.5;
  EXPECT_EQ(MakePsf(smeared, 3)->terms.size(), 1U);
}

TEST(PsfTerms, MeetTheToleranceWithAsFewTermsAsItTakes) {
  Rng rng({11});
  for (int trial = 0; trial < 5; ++trial) {
    Eigen::MatrixXd kernel(15, 15);
    for (int j = 0; j < 15; ++j) {
      for (int i = 0; i < 15; ++i) kernel(j, i) = std::exp(-0.5 * ((i - 7) * (i - 7) + (j - 7) * (j - 7)) / 6.0) * (1.0 + 0.5 * rng.Uniform());
    }
    const Psf psf = DecomposeKernel(kernel);
    const Eigen::MatrixXd target = kernel / kernel.sum();
    EXPECT_LE((KernelOf(psf) - target).cwiseAbs().sum(), 2.0 * kDecompositionTolerance) << "normalising doubles it at worst";
    EXPECT_NEAR(KernelOf(psf).sum(), 1.0, 1e-6);
    EXPECT_LE(psf.negative_mass, kDecompositionTolerance);
    Psf shorter = psf;
    ASSERT_GT(shorter.terms.size(), 1U);
    shorter.terms.pop_back();
    EXPECT_GT((KernelOf(shorter) - target).cwiseAbs().sum(), 0.5 * kDecompositionTolerance);
  }
}

TEST(PsfTerms, AProductIsOneTerm) {
  Eigen::VectorXd row(7);
  Eigen::VectorXd column(7);
  row << 0.0, 1.0, 3.0, 5.0, 2.0, 1.0, 0.5;
  column << 1.0, 2.0, 3.0, 4.0, 3.0, 1.0, 0.0;
  EXPECT_EQ(DecomposeKernel(column * row.transpose()).terms.size(), 1U);
}

TEST(PsfTerms, TheUsualSensorsNeedFew) {
  const auto psfs = SamplePsfs();
  EXPECT_TRUE(psfs.at("gaussian").is_rank_one_symmetric());
  for (const auto& [name, psf] : psfs) {
    EXPECT_LE(psf.terms.size(), 14U) << name;
    std::printf("%-18s %zu terms of radius %d, negative mass %.1e\n", name.c_str(), psf.terms.size(), psf.radius(), psf.negative_mass);
  }
}

TEST(PsfParametersTest, ModelsNameTheFieldThatIsWrong) {
  EXPECT_NE(MakePsf(Optics(0.01), 3).status().message().find("wavelength_um"), std::string::npos);
  EXPECT_NE(MakePsf(Optics(1.0, 7.0), 3).status().message().find("psf_sigma_px"), std::string::npos);
  PsfParameters smeared{0.6, 0.9};
  smeared.smear_px = 11.0;
  EXPECT_NE(MakePsf(smeared, 3).status().message().find("smear_px"), std::string::npos);
}

}  // namespace
}  // namespace trem
