#include "worker/sensor/term_filter.h"

#include <algorithm>

#include "worker/sensor/reflect.h"

namespace trem {
namespace {

void AddScaled(const float* in, float factor, int count, float* out) {
  for (int x = 0; x < count; ++x) out[x] += factor * in[x];
}

}  // namespace

// rows_(i, x) = sum_k row[k + r] * input(region.x0 + x - k, reflected row region.y0 - r + i).
void TermFilter::FilterRows(const PsfTerm& term, const Image<float>& input, const Roi& region) {
  const int radius = static_cast<int>(term.row.size() / 2);
  const int width = region.width();
  const int padded_width = width + 2 * radius;
  padded_.resize(static_cast<std::size_t>(padded_width));
  for (int i = 0; i < region.height() + 2 * radius; ++i) {
    const float* source = input.row(ReflectIndex(region.y0 - radius + i, input.height()));
    for (int x = 0; x < padded_width; ++x) padded_[static_cast<std::size_t>(x)] = source[ReflectIndex(region.x0 - radius + x, input.width())];
    float* out = rows_.row(i);
    std::fill(out, out + width, 0.0F);
    for (int k = -radius; k <= radius; ++k) AddScaled(padded_.data() + radius - k, term.row[static_cast<std::size_t>(k + radius)], width, out);
  }
}

void TermFilter::Apply(const Psf& psf, const Image<float>& input, const Roi& region, Image<float>* output) {
  const int radius = psf.radius();
  const int rows = region.height() + 2 * radius;
  if (rows_.width() != region.width() || rows_.height() < rows) rows_ = Image<float>(region.width(), rows);
  for (int y = region.y0; y < region.y1; ++y) std::fill_n(output->row(y) + region.x0, region.width(), 0.0F);
  for (const PsfTerm& term : psf.terms) {
    FilterRows(term, input, region);
    for (int y = 0; y < region.height(); ++y) {
      float* out = output->row(region.y0 + y) + region.x0;
      for (int k = -radius; k <= radius; ++k) AddScaled(rows_.row(y + radius - k), term.column[static_cast<std::size_t>(k + radius)], region.width(), out);
    }
  }
}

// rows_(i, x) = sum over the positions p whose reflection is region.x0 + x of sum_k row[k + r] * input(p + k, row region.y0 - r + i);
// rows outside the image are left out (0).
void TermFilter::GatherRows(const PsfTerm& term, const Image<float>& input, const Roi& region) {
  const int radius = static_cast<int>(term.row.size() / 2);
  const int width = region.width();
  const int padded_width = width + 2 * radius;
  padded_.resize(static_cast<std::size_t>(padded_width));
  for (int i = 0; i < region.height() + 2 * radius; ++i) {
    float* out = rows_.row(i);
    std::fill(out, out + width, 0.0F);
    const int y = region.y0 - radius + i;
    if (y < 0 || y >= input.height()) continue;
    const float* source = input.row(y);
    for (int x = 0; x < padded_width; ++x) {
      const int from = region.x0 - radius + x;
      padded_[static_cast<std::size_t>(x)] = from >= 0 && from < input.width() ? source[from] : 0.0F;
    }
    for (int k = -radius; k <= radius; ++k) AddScaled(padded_.data() + radius + k, term.row[static_cast<std::size_t>(k + radius)], width, out);
    const auto fold = [&](int p) {
      const int x = ReflectIndex(p, input.width());
      if (x < region.x0 || x >= region.x1) return;
      for (int k = -radius; k <= radius; ++k) {
        if (p + k >= 0 && p + k < input.width()) out[x - region.x0] += term.row[static_cast<std::size_t>(k + radius)] * source[p + k];
      }
    };
    for (int p = -radius; p < 0; ++p) fold(p);
    for (int p = input.width(); p < input.width() + radius; ++p) fold(p);
  }
}

void TermFilter::ApplyAdjoint(const Psf& psf, const Image<float>& input, const Roi& region, Image<float>* output) {
  const int radius = psf.radius();
  const int rows = region.height() + 2 * radius;
  const int height = input.height();
  if (rows_.width() != region.width() || rows_.height() < rows) rows_ = Image<float>(region.width(), rows);
  for (int y = region.y0; y < region.y1; ++y) std::fill_n(output->row(y) + region.x0, region.width(), 0.0F);
  for (const PsfTerm& term : psf.terms) {
    GatherRows(term, input, region);
    // Adds what the position p of the continued column gathers to the row that it reflects.
    const auto add = [&](int p) {
      const int y = ReflectIndex(p, height);
      if (y < region.y0 || y >= region.y1) return;
      for (int k = -radius; k <= radius; ++k) {
        const int row = p + k - (region.y0 - radius);
        if (p + k < 0 || p + k >= height || row < 0 || row >= rows) continue;
        AddScaled(rows_.row(row), term.column[static_cast<std::size_t>(k + radius)], region.width(), output->row(y) + region.x0);
      }
    };
    for (int p = region.y0; p < region.y1; ++p) add(p);
    for (int p = -radius; p < 0; ++p) add(p);
    for (int p = height; p < height + radius; ++p) add(p);
  }
}

}  // namespace trem
