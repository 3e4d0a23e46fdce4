#include "worker/sensor/psf_kernel.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>

#include "worker/sensor/bicubic.h"

namespace trem {
namespace {

constexpr double kNegativeMax = 0.05;
constexpr double kSideMax_px = 20.0;
constexpr double kSamplingMin = 0.5;
constexpr double kSamplingMax = 64.0;
constexpr std::string_view kSamplingWord = "samples_per_pixel";

bool IsBlank(char c) { return c == ' ' || c == '\t' || c == ',' || c == '\r'; }

// The text's words with where they stand; lines end the row of words.
class WordReader {
 public:
  WordReader(std::string_view text, const std::string& file_name) : text_(text), file_name_(file_name) {}

  struct Word {
    std::string_view text;
    int line = 0;
    int column = 0;
  };

  // Fills the words of the next line that has any; false at the end.
  bool NextLine(std::vector<Word>* words) {
    words->clear();
    while (at_ < text_.size() && words->empty()) {
      ++line_;
      std::size_t end = text_.find('\n', at_);
      if (end == std::string_view::npos) end = text_.size();
      Split(text_.substr(at_, end - at_), words);
      at_ = end + 1;
    }
    return !words->empty();
  }

  Status Refuse(int line, int column, const std::string& found, const std::string& expected) const {
    return InvalidInput(file_name_ + ":" + std::to_string(line) + ":" + std::to_string(column) + ": " + found + "; expected " + expected);
  }

 private:
  void Split(std::string_view line, std::vector<Word>* words) const {
    line = line.substr(0, line.find('#'));
    for (std::size_t i = 0; i < line.size();) {
      if (IsBlank(line[i])) {
        ++i;
        continue;
      }
      std::size_t end = i;
      while (end < line.size() && !IsBlank(line[end])) ++end;
      words->push_back({line.substr(i, end - i), line_, static_cast<int>(i) + 1});
      // One more than is allowed is enough to refuse the line.
      if (words->size() > kKernelSideMax) return;
      i = end;
    }
  }

  std::string_view text_;
  const std::string& file_name_;
  std::size_t at_ = 0;
  int line_ = 0;
};

std::optional<double> ParseNumber(std::string_view word) {
  if (!word.empty() && word.front() == '+') word.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size() || !std::isfinite(value) || std::abs(value) > 1e30) return std::nullopt;
  return value;
}

// A word as a message shows it.
std::string Quoted(std::string_view word) {
  std::string shown;
  for (const char c : word.substr(0, 24)) shown += c >= 0x20 && c < 0x7f ? c : '?';
  return "'" + shown + (word.size() > 24 ? "...'" : "'");
}

Status ReadSampling(const WordReader& reader, const std::vector<WordReader::Word>& words, PsfKernel* kernel) {
  const WordReader::Word& word = words.front();
  if (kernel->samples_per_pixel > 0.0) return reader.Refuse(word.line, word.column, "samples_per_pixel is given twice", "it once");
  if (kernel->height > 0) return reader.Refuse(word.line, word.column, "samples_per_pixel after the numbers", "it before them");
  const std::optional<double> value = words.size() == 2 ? ParseNumber(words[1].text) : std::nullopt;
  if (!value.has_value() || !(*value >= kSamplingMin && *value <= kSamplingMax)) {
    return reader.Refuse(word.line, words.size() > 1 ? words[1].column : word.column,
                         words.size() == 2 ? Quoted(words[1].text) : std::to_string(words.size() - 1) + " values",
                         "one number from 0.5 to 64 after samples_per_pixel");
  }
  kernel->samples_per_pixel = *value;
  return {};
}

Status ReadRow(const WordReader& reader, const std::vector<WordReader::Word>& words, PsfKernel* kernel) {
  const WordReader::Word& first = words.front();
  if (kernel->samples_per_pixel == 0.0) {
    return reader.Refuse(first.line, first.column, Quoted(first.text), "the line 'samples_per_pixel NUMBER' before the kernel's numbers");
  }
  if (words.size() > kKernelSideMax || kernel->height == kKernelSideMax) {
    return reader.Refuse(first.line, first.column, words.size() > kKernelSideMax ? "more than 256 numbers in a line" : "a 257th line of numbers",
                         "a kernel of at most 256 x 256 samples");
  }
  if (kernel->height > 0 && static_cast<int>(words.size()) != kernel->width) {
    return reader.Refuse(first.line, first.column, std::to_string(words.size()) + " numbers",
                         std::to_string(kernel->width) + " like in the first line");
  }
  kernel->width = static_cast<int>(words.size());
  ++kernel->height;
  for (const WordReader::Word& word : words) {
    const std::optional<double> value = ParseNumber(word.text);
    if (!value.has_value()) return reader.Refuse(word.line, word.column, Quoted(word.text), "a finite number");
    kernel->values.push_back(static_cast<float>(*value));
  }
  return {};
}

}  // namespace

Result<PsfKernel> ParsePsfKernel(std::string_view text, const std::string& file_name) {
  if (text.size() > kKernelFileBytesMax) {
    return InvalidInput(file_name + ": is " + std::to_string(text.size()) + " bytes long; expected at most " + std::to_string(kKernelFileBytesMax));
  }
  PsfKernel kernel;
  WordReader reader(text, file_name);
  std::vector<WordReader::Word> words;
  while (reader.NextLine(&words)) {
    TREM_RETURN_IF_ERROR(words.front().text == kSamplingWord ? ReadSampling(reader, words, &kernel) : ReadRow(reader, words, &kernel));
  }
  TREM_RETURN_IF_ERROR(CheckPsfKernel(kernel, file_name));
  return kernel;
}

Status CheckPsfKernel(const PsfKernel& kernel, const std::string& subject) {
  const std::string size = std::to_string(kernel.width) + " x " + std::to_string(kernel.height);
  if (kernel.width < 1 || kernel.height < 1 || kernel.width > kKernelSideMax || kernel.height > kKernelSideMax) {
    return InvalidInput(subject + ": the kernel has " + size + " samples; expected 1 to 256 a side");
  }
  TREM_CHECK(kernel.values.size() == static_cast<std::size_t>(kernel.width) * static_cast<std::size_t>(kernel.height));
  if (!(kernel.samples_per_pixel >= kSamplingMin && kernel.samples_per_pixel <= kSamplingMax)) {
    return InvalidInput(subject + ": samples_per_pixel is " + std::to_string(kernel.samples_per_pixel) + "; expected 0.5 to 64");
  }
  if (std::max(kernel.width, kernel.height) > kSideMax_px * kernel.samples_per_pixel) {
    return InvalidInput(subject + ": the kernel has " + size + " samples, " + std::to_string(kernel.samples_per_pixel) +
                        " a sensor pixel; expected at most 20 sensor pixels a side: cut it or correct samples_per_pixel");
  }
  double positive = 0.0;
  double negative = 0.0;
  for (std::size_t i = 0; i < kernel.values.size(); ++i) {
    const float value = kernel.values[i];
    if (!std::isfinite(value)) {
      return InvalidInput(subject + ": sample " + std::to_string(i % static_cast<std::size_t>(kernel.width)) + ", " +
                          std::to_string(i / static_cast<std::size_t>(kernel.width)) + " (x, y) is not finite; expected finite numbers");
    }
    (value > 0.0F ? positive : negative) += value;
  }
  if (!(positive > 0.0)) return InvalidInput(subject + ": no sample of the kernel is positive; expected a positive sum");
  if (-negative > kNegativeMax * positive) {
    return InvalidInput(subject + ": its negative samples add up to " + std::to_string(-100.0 * negative / positive) +
                        " % of the positive ones; expected at most 5 %: subtract the background of the measurement");
  }
  return {};
}

KernelCentroid CentroidOf(const PsfKernel& kernel) {
  KernelCentroid centroid;
  double sum = 0.0;
  for (int y = 0; y < kernel.height; ++y) {
    for (int x = 0; x < kernel.width; ++x) {
      const double value = std::max(kernel.at(x, y), 0.0F);
      sum += value;
      centroid.x += value * (x - 0.5 * (kernel.width - 1));
      centroid.y += value * (y - 0.5 * (kernel.height - 1));
    }
  }
  centroid.x /= sum;
  centroid.y /= sum;
  return centroid;
}

double SampleKernel(const PsfKernel& kernel, const KernelCentroid& centroid, double x, double y) {
  const double fx = x + centroid.x + 0.5 * (kernel.width - 1);
  const double fy = y + centroid.y + 0.5 * (kernel.height - 1);
  if (!(fx > -2.0 && fy > -2.0 && fx < kernel.width + 1.0 && fy < kernel.height + 1.0)) return 0.0;
  const int ix = static_cast<int>(std::floor(fx));
  const int iy = static_cast<int>(std::floor(fy));
  const std::array<float, 4> wx = CubicWeights(static_cast<float>(fx - ix));
  const std::array<float, 4> wy = CubicWeights(static_cast<float>(fy - iy));
  double sum = 0.0;
  for (int j = 0; j < 4; ++j) {
    for (int i = 0; i < 4; ++i) {
      const int px = ix - 1 + i;
      const int py = iy - 1 + j;
      if (px < 0 || py < 0 || px >= kernel.width || py >= kernel.height) continue;
      sum += static_cast<double>(wx[static_cast<std::size_t>(i)]) * wy[static_cast<std::size_t>(j)] * kernel.at(px, py);
    }
  }
  return std::max(sum, 0.0);
}

}  // namespace trem
