#pragma once

#include <cstdint>
#include <vector>

#include "worker/sensor/blur.h"
#include "worker/tre/update_scheme.h"

namespace trem {

// The year-1 scheme: the scene's points are visited in pseudo-random order, and each is set to the mean of its conditional given its
// neighbours and all samples that it feeds through the PSF. The samples are the accumulated, residual-corrected ones (W and Z of the
// buffer), of every frame so far and not of the last few:
//
//   S_c <- S_c - (h_c' (W B S - Z) + lambda prior'_c) / (h_c' W h_c + lambda prior''_c),   h_c = B e_c
//
// Under a quadratic prior that is coordinate descent; under Huber's the parabola that touches psi from above takes its place, so that no
// visit raises the objective, which is InformationUpdate's. A sweep visits every cell of the region once, in an order keyed by
// (seed, segment, sweep). Cost a visit: three passes over the (2 radius + 1)^2 cells that the PSF reaches.
// Source: Sauer & Bouman, IEEE Trans. SP 41(2), 1993 (iterative coordinate descent).
class PointwiseUpdate : public UpdateScheme {
 public:
  PointwiseUpdate(const Psf& psf, std::uint64_t seed, std::uint64_t segment_id);

  void AddFrame(int, const Observation&, const View&) override {}
  void Iterate(const Roi& region, int iterations, const StructurePrior& prior, float lambda, SceneBuffer* buffer) override;
  bool remembers() const override { return true; }

 private:
  // Calls visit(row of the kernel, first x in the buffer, y in the buffer, cells) for every row of cells that (x, y) feeds, once for each
  // image of the cell under the border's reflection.
  template <typename Visit>
  void ForEachRow(int x, int y, int width, int height, const Visit& visit) const;
  void VisitCell(int x, int y, const Roi& inner, const StructurePrior& prior, float lambda, SceneBuffer* buffer);

  Blur blur_;
  Image<float> kernel_;  // (2 radius + 1)^2: what a cell leaves around it.
  std::uint64_t seed_;
  std::uint64_t segment_id_;
  std::uint64_t sweep_count_ = 0;
  Image<float> misfit_;  // W B S - Z, kept up to date with every visit.
};

}  // namespace trem
