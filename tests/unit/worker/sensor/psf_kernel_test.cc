// Goal: a kernel file is read as it is documented, refused with the place of what is wrong, and used about its centroid at the sampling of the
// scene. Method: texts; a Gaussian kernel sampled off centre against the closed-form Gaussian PSF.
#include "worker/sensor/psf_kernel.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "worker/sensor/psf.h"
#include "worker/sensor/psf_spectrum.h"
#include "worker/sensor/psf_terms.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

TEST(ParsePsfKernel, ReadsBlanksCommasCommentsAndWindowsLines) {
  const auto kernel = ParsePsfKernel("# measured\r\n\r\nsamples_per_pixel 2.5\r\n0 1,\t2 # a row\r\n+3 4.5e0 -0.1\r\n", "k.txt");
  ASSERT_TRUE(kernel.ok()) << kernel.status().message();
  EXPECT_EQ(kernel->width, 3);
  EXPECT_EQ(kernel->height, 2);
  EXPECT_EQ(kernel->samples_per_pixel, 2.5);
  EXPECT_EQ(kernel->at(2, 0), 2.0F);
  EXPECT_EQ(kernel->at(1, 1), 4.5F);
  EXPECT_EQ(kernel->at(2, 1), -0.1F);
}

TEST(ParsePsfKernel, RefusesWithFileLineAndColumn) {
  for (const auto& [text, message] : std::vector<std::pair<std::string, std::string>>{
           {"samples_per_pixel 4\n1 2 x3\n", "k.txt:2:5: 'x3'; expected a finite number"},
           {"samples_per_pixel 4\n1 nan\n", "k.txt:2:3: 'nan'"},
           {"samples_per_pixel 4\n1 1e39\n", "k.txt:2:3: '1e39'"},
           {"samples_per_pixel 4\n1 2\n\n1 2 3\n", "k.txt:4:1: 3 numbers; expected 2"},
           {"1 2\n", "k.txt:1:1: '1'; expected the line 'samples_per_pixel NUMBER'"},
           {"samples_per_pixel\n", "k.txt:1:1: 0 values"},
           {"samples_per_pixel 0\n1\n", "k.txt:1:19: '0'"},
           {"samples_per_pixel 4\nsamples_per_pixel 4\n", "k.txt:2:1: samples_per_pixel is given twice"},
           {"samples_per_pixel 4\n1\nsamples_per_pixel 4\n", "k.txt:3:1: samples_per_pixel"},
           {"samples_per_pixel 4\n", "k.txt: the kernel has 0 x 0 samples"},
           {"samples_per_pixel 4\n0 0\n", "k.txt: no sample of the kernel is positive"},
           {"samples_per_pixel 4\n1 -0.2\n", "k.txt: its negative samples add up to 20"},
           {"samples_per_pixel 0.5\n1 1 1 1 1 1 1 1 1 1 1 1\n", "k.txt: the kernel has 12 x 1 samples"}}) {
    const auto kernel = ParsePsfKernel(text, "k.txt");
    ASSERT_FALSE(kernel.ok()) << text;
    EXPECT_EQ(kernel.status().code(), StatusCode::kInvalidInput);
    EXPECT_THAT(kernel.status().message(), StartsWith(message)) << text;
  }
}

TEST(ParsePsfKernel, RefusesWhatIsTooLargeBeforeItFillsMemory) {
  std::string wide = "samples_per_pixel 64\n";
  for (int i = 0; i < 257; ++i) wide += "1 ";
  EXPECT_THAT(ParsePsfKernel(wide, "k.txt").status().message(), HasSubstr("more than 256 numbers"));
  std::string high = "samples_per_pixel 64\n";
  for (int i = 0; i < 257; ++i) high += "1\n";
  EXPECT_THAT(ParsePsfKernel(high, "k.txt").status().message(), StartsWith("k.txt:258:1: a 257th line"));
  EXPECT_THAT(ParsePsfKernel(std::string(kKernelFileBytesMax + 1, ' '), "k.txt").status().message(), HasSubstr("bytes long"));
}

// A Gaussian of 0.7 px, sampled `per_pixel` times a pixel with its centre (0.3, -0.4) samples from the middle of the file.
PsfKernel GaussianKernel(double per_pixel, int side) {
  PsfKernel kernel{side, side, per_pixel, {}};
  const double sigma = 0.7 * per_pixel;
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const double dx = x - 0.5 * (side - 1) - 0.3;
      const double dy = y - 0.5 * (side - 1) + 0.4;
      kernel.values.push_back(static_cast<float>(std::exp(-0.5 * (dx * dx + dy * dy) / (sigma * sigma))));
    }
  }
  return kernel;
}

TEST(KernelPsf, IsTheSamePsfWhateverItsSamplingParityAndPlaceInTheFile) {
  for (const auto& [per_pixel, side] : {std::pair{3.0, 25}, {4.0, 32}, {2.5, 21}, {6.0, 48}}) {
    PsfParameters file;
    file.model = PsfModel::kKernelFile;
    file.kernel = GaussianKernel(per_pixel, side);
    const KernelCentroid centroid = CentroidOf(file.kernel);
    EXPECT_NEAR(centroid.x, 0.3, 1e-3);
    EXPECT_NEAR(centroid.y, -0.4, 1e-3);
    const Eigen::MatrixXd kernel = KernelOf(*MakePsf(file, 3));
    const int radius = static_cast<int>(kernel.rows() / 2);
    for (int j = -radius; j <= radius; ++j) {
      for (int i = -radius; i <= radius; ++i) {
        const double expected = std::exp(-0.5 * (i * i + j * j) / (2.1 * 2.1)) / (2.0 * M_PI * 2.1 * 2.1);
        EXPECT_NEAR(kernel(j + radius, i + radius), expected, 8e-4) << per_pixel << ": " << i << ", " << j;
      }
    }
  }
}

TEST(KernelPsf, SmearsLikeTheOtherModels) {
  PsfParameters file;
  file.model = PsfModel::kKernelFile;
  file.kernel = GaussianKernel(4.0, 32);
  file.smear_px = 2.0;
  file.smear_direction_rad = 0.6;
  PsfParameters closed{0.7, 0.001};
  closed.smear_px = 2.0;
  closed.smear_direction_rad = 0.6;
  const Eigen::MatrixXd a = KernelOf(*MakePsf(file, 3));
  const Eigen::MatrixXd b = KernelOf(*MakePsf(closed, 3));
  const auto middle = std::min(a.rows(), b.rows()) / 2;
  for (auto j = -middle; j <= middle; ++j) {
    for (auto i = -middle; i <= middle; ++i) EXPECT_NEAR(a(a.rows() / 2 + j, a.rows() / 2 + i), b(b.rows() / 2 + j, b.rows() / 2 + i), 6e-4);
  }
}

TEST(KernelPsf, APointBetweenTheCellsIsStillAPsfOrARefusal) {
  // A single sample, much finer than the scene: it has no width on the grid, but a centroid on a cell.
  PsfParameters file;
  file.model = PsfModel::kKernelFile;
  file.kernel = {1, 1, 64.0, {1.0F}};
  const auto psf = MakePsf(file, 3);
  ASSERT_TRUE(psf.ok());
  EXPECT_NEAR(KernelOf(*psf).sum(), 1.0, 1e-6);
}

}  // namespace
}  // namespace trem
