#include "mosaic/align/content_ties.h"

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <set>

namespace trem::align {
namespace {

constexpr int kDescriptorSize = 128;

// 8-bit picture of the scene at sensor resolution, and where it was seen.
void ReduceScene(const Image<float>& intensity, const Image<float>& information, int ratio, cv::Mat* picture, cv::Mat* mask) {
  const int width = intensity.width() / ratio;
  const int height = intensity.height() / ratio;
  cv::Mat mean(height, width, CV_32F, cv::Scalar(0));
  *mask = cv::Mat(height, width, CV_8U, cv::Scalar(0));
  double sum = 0.0, sum2 = 0.0, count = 0.0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      double total = 0.0;
      int seen = 0;
      for (int j = 0; j < ratio; ++j) {
        for (int i = 0; i < ratio; ++i) {
          const float value = intensity.at(x * ratio + i, y * ratio + j);
          if (!(information.at(x * ratio + i, y * ratio + j) > 0.0F) || !std::isfinite(value)) continue;
          total += value;
          ++seen;
        }
      }
      if (2 * seen < ratio * ratio) continue;
      const double value = total / seen;
      mean.at<float>(y, x) = static_cast<float>(value);
      mask->at<unsigned char>(y, x) = 255;
      sum += value;
      sum2 += value * value;
      count += 1.0;
    }
  }
  const double average = count > 0.0 ? sum / count : 0.0;
  const double deviation = count > 0.0 ? std::sqrt(std::max(1e-6, sum2 / count - average * average)) : 1.0;
  // Contrast to a standard spread, so that faint thermal scenes give features too; the unseen part is flat.
  mean.setTo(average, *mask == 0);
  mean.convertTo(*picture, CV_8U, 40.0 / deviation, 128.0 - average * 40.0 / deviation);
  cv::erode(*mask, *mask, cv::Mat(), cv::Point(-1, -1), 5, cv::BORDER_CONSTANT, cv::Scalar(255));
}

// Fraction of a's rectangle that lies in b's, from a grid of points; 0 when a point leaves the horizon.
double OverlapFraction(const SceneNode& a, const Homography& b_from_a, const SceneNode& b) {
  constexpr int kGrid = 9;
  int inside = 0;
  const Roi& from = a.scene.roi_in_scene;
  const Roi& to = b.scene.roi_in_scene;
  for (int j = 0; j < kGrid; ++j) {
    for (int i = 0; i < kGrid; ++i) {
      const Eigen::Vector2d x(from.x0 + (i + 0.5) * from.width() / kGrid, from.y0 + (j + 0.5) * from.height() / kGrid);
      const double depth = b_from_a.Depth(x);
      if (std::abs(depth) < 1e-12) return 0.0;
      const Eigen::Vector2d y = b_from_a * x;
      if (y.x() >= to.x0 && y.x() < to.x1 && y.y() >= to.y0 && y.y() < to.y1) ++inside;
    }
  }
  return static_cast<double>(inside) / (kGrid * kGrid);
}

struct Footprint {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0.0;
  double middle_frame = 0.0;
  std::vector<int> frames;  // Sorted.
};

Footprint FootprintOf(const AlignGraph& graph, const AlignState& state, int s) {
  const SceneNode& node = graph.scenes[static_cast<std::size_t>(s)];
  const Homography& world_from_scene = state.scenes[static_cast<std::size_t>(s)].world_from_scene;
  const Roi& roi = node.scene.roi_in_scene;
  Footprint footprint;
  footprint.centre = world_from_scene * Eigen::Vector2d(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
  for (const Eigen::Vector2d& corner : RoiCorners(roi))
    footprint.radius = std::max(footprint.radius, (world_from_scene * corner - footprint.centre).norm());
  footprint.middle_frame = 0.5 * (static_cast<double>(node.scene.frame_begin) + node.scene.frame_end);
  for (const int t : node.ties) footprint.frames.push_back(graph.ties[static_cast<std::size_t>(t)].frame);
  std::sort(footprint.frames.begin(), footprint.frames.end());
  return footprint;
}

bool ShareAFrame(const Footprint& a, const Footprint& b) {
  std::vector<int> common;
  std::set_intersection(a.frames.begin(), a.frames.end(), b.frames.begin(), b.frames.end(), std::back_inserter(common));
  return !common.empty();
}

// A third of `limit` from the front of `sorted`, the rest evenly from what follows.
std::vector<int> Spread(const std::vector<int>& sorted, int limit) {
  const int size = static_cast<int>(sorted.size());
  if (size <= limit) return sorted;
  const int front = std::max(1, limit / 3);
  std::vector<int> chosen(sorted.begin(), sorted.begin() + front);
  const int rest = limit - front;
  for (int k = 0; k < rest; ++k) chosen.push_back(sorted[static_cast<std::size_t>(front + (2 * k + 1) * (size - front) / (2 * rest))]);
  return chosen;
}

// Whether the state says how two scenes lie to each other: they are in one piece, or telemetry places both.
bool AreComparable(const AlignState& state, std::size_t a, std::size_t b) {
  const int piece_a = state.scenes[a].piece, piece_b = state.scenes[b].piece;
  if (piece_a == piece_b) return true;
  return state.piece_anchored[static_cast<std::size_t>(piece_a)] && state.piece_anchored[static_cast<std::size_t>(piece_b)];
}

void AddPairsWithinPieces(const AlignGraph& graph, const AlignState& state, const std::vector<int>& members, const ContentOptions& options,
                          std::set<std::pair<int, int>>& pairs) {
  std::vector<Footprint> footprints;
  for (const int s : members) footprints.push_back(FootprintOf(graph, state, s));
  for (std::size_t i = 0; i < members.size(); ++i) {
    const auto a = static_cast<std::size_t>(members[i]);
    std::vector<int> partners;
    for (std::size_t j = 0; j < members.size(); ++j) {
      const auto b = static_cast<std::size_t>(members[j]);
      if (i == j || !AreComparable(state, a, b)) continue;
      if (!((footprints[i].centre - footprints[j].centre).norm() < footprints[i].radius + footprints[j].radius)) continue;
      if (!options.may_share_frames && ShareAFrame(footprints[i], footprints[j])) continue;
      const Homography b_from_a = state.scenes[b].world_from_scene.Inverse() * state.scenes[a].world_from_scene;
      const double overlap = std::max(OverlapFraction(graph.scenes[a], b_from_a, graph.scenes[b]),
                                      OverlapFraction(graph.scenes[b], b_from_a.Inverse(), graph.scenes[a]));
      if (overlap >= options.overlap_min) partners.push_back(static_cast<int>(j));
    }
    std::stable_sort(partners.begin(), partners.end(), [&](int p, int q) {
      return std::abs(footprints[static_cast<std::size_t>(p)].middle_frame - footprints[i].middle_frame) <
             std::abs(footprints[static_cast<std::size_t>(q)].middle_frame - footprints[i].middle_frame);
    });
    for (const int j : Spread(partners, options.partners_max)) {
      const int s = members[static_cast<std::size_t>(j)];
      pairs.insert({std::min(members[i], s), std::max(members[i], s)});
    }
  }
}

void AddPairsBetweenPieces(const AlignState& state, const std::vector<int>& members, const ContentOptions& options,
                           std::set<std::pair<int, int>>& pairs) {
  std::vector<std::pair<int, int>> unknown;
  for (std::size_t i = 0; i < members.size(); ++i) {
    for (std::size_t j = i + 1; j < members.size(); ++j) {
      const int piece_a = state.scenes[static_cast<std::size_t>(members[i])].piece;
      const int piece_b = state.scenes[static_cast<std::size_t>(members[j])].piece;
      if (piece_a == piece_b) continue;
      if (state.piece_anchored[static_cast<std::size_t>(piece_a)] && state.piece_anchored[static_cast<std::size_t>(piece_b)]) continue;
      unknown.emplace_back(members[i], members[j]);
    }
  }
  const std::size_t limit = static_cast<std::size_t>(options.cross_piece_pairs_max);
  const std::size_t count = std::min(limit, unknown.size());
  for (std::size_t k = 0; k < count; ++k) pairs.insert(unknown[(2 * k + 1) * unknown.size() / (2 * count)]);
}

// At most `limit` of the inliers, spread over the scene: the points are sorted along a serpentine of a 4 x 4 grid and taken evenly.
std::vector<std::size_t> SpreadPoints(const std::vector<Eigen::Vector2d>& points, const std::vector<std::size_t>& inliers, int limit) {
  Eigen::Vector2d low = points[inliers.front()];
  Eigen::Vector2d high = low;
  for (const std::size_t i : inliers) {
    low = low.cwiseMin(points[i]);
    high = high.cwiseMax(points[i]);
  }
  const Eigen::Vector2d size = (high - low).cwiseMax(1e-9);
  std::vector<std::pair<int, std::size_t>> order;
  for (const std::size_t i : inliers) {
    const int column = std::min(3, static_cast<int>(4.0 * (points[i].x() - low.x()) / size.x()));
    const int row = std::min(3, static_cast<int>(4.0 * (points[i].y() - low.y()) / size.y()));
    order.emplace_back(4 * row + (row % 2 == 0 ? column : 3 - column), i);
  }
  std::sort(order.begin(), order.end());
  const std::size_t count = std::min(order.size(), static_cast<std::size_t>(limit));
  std::vector<std::size_t> chosen;
  for (std::size_t k = 0; k < count; ++k) chosen.push_back(order[(2 * k + 1) * order.size() / (2 * count)].second);
  return chosen;
}

}  // namespace

SceneFeatures ExtractFeatures(const Image<float>& intensity, const Image<float>& information, const Roi& roi_in_scene, int ratio,
                              const ContentOptions& options) {
  SceneFeatures features;
  if (intensity.width() < 16 * ratio || intensity.height() < 16 * ratio) return features;
  cv::Mat picture, mask;
  ReduceScene(intensity, information, ratio, &picture, &mask);
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;
  cv::SIFT::create(options.features_max, 3, 0.02, 10.0, 1.6)->detectAndCompute(picture, mask, points, descriptors);
  // Pixel (x, y) of the picture is the mean of cells x * ratio .. x * ratio + ratio - 1.
  const double half = 0.5 * (ratio - 1);
  for (std::size_t i = 0; i < points.size(); ++i) {
    features.x_in_scene.emplace_back(roi_in_scene.x0 + points[i].pt.x * ratio + half, roi_in_scene.y0 + points[i].pt.y * ratio + half);
    const float* const row = descriptors.ptr<float>(static_cast<int>(i));
    for (int k = 0; k < kDescriptorSize; ++k) features.descriptors.push_back(cv::saturate_cast<std::uint8_t>(row[k]));
  }
  return features;
}

std::optional<ContentTie> MatchFeatures(int scene_a, const SceneFeatures& a, int scene_b, const SceneFeatures& b, int ratio,
                                        const ContentOptions& options) {
  const auto count_a = static_cast<int>(a.x_in_scene.size());
  const auto count_b = static_cast<int>(b.x_in_scene.size());
  if (count_a < options.inliers_min || count_b < options.inliers_min) return std::nullopt;
  const cv::Mat descriptors_a(count_a, kDescriptorSize, CV_8U, const_cast<std::uint8_t*>(a.descriptors.data()));
  const cv::Mat descriptors_b(count_b, kDescriptorSize, CV_8U, const_cast<std::uint8_t*>(b.descriptors.data()));
  std::vector<std::vector<cv::DMatch>> matches;
  cv::BFMatcher(cv::NORM_L2).knnMatch(descriptors_a, descriptors_b, matches, 2);
  std::vector<Eigen::Vector2d> x_in_a, x_in_b;
  std::vector<cv::Point2f> sensor_a, sensor_b;
  std::set<int> taken;  // Each feature of b serves once: repeated texture would vote many times.
  for (const auto& match : matches) {
    if (match.size() < 2 || !(match[0].distance < options.descriptor_ratio_max * match[1].distance)) continue;
    if (!taken.insert(match[0].trainIdx).second) continue;
    x_in_a.push_back(a.x_in_scene[static_cast<std::size_t>(match[0].queryIdx)]);
    x_in_b.push_back(b.x_in_scene[static_cast<std::size_t>(match[0].trainIdx)]);
    sensor_a.emplace_back(static_cast<float>(x_in_a.back().x() / ratio), static_cast<float>(x_in_a.back().y() / ratio));
    sensor_b.emplace_back(static_cast<float>(x_in_b.back().x() / ratio), static_cast<float>(x_in_b.back().y() / ratio));
  }
  if (static_cast<int>(x_in_a.size()) < options.inliers_min) return std::nullopt;
  std::vector<unsigned char> good;
  const cv::Mat b_from_a = cv::estimateAffine2D(sensor_a, sensor_b, good, cv::RANSAC, options.inlier_px, 2000, 0.999, 10);
  if (b_from_a.empty()) return std::nullopt;
  const double area = b_from_a.at<double>(0, 0) * b_from_a.at<double>(1, 1) - b_from_a.at<double>(0, 1) * b_from_a.at<double>(1, 0);
  std::vector<std::size_t> inliers;
  for (std::size_t i = 0; i < good.size(); ++i) {
    if (good[i] != 0) inliers.push_back(i);
  }
  if (!(area > 0.25 && area < 4.0) || static_cast<int>(inliers.size()) < options.inliers_min) return std::nullopt;
  if (static_cast<double>(inliers.size()) < options.inlier_fraction_min * static_cast<double>(x_in_a.size())) return std::nullopt;
  ContentTie tie{scene_a, scene_b, {}, {}};
  for (const std::size_t i : SpreadPoints(x_in_a, inliers, options.points_max)) {
    tie.x_in_a.push_back(x_in_a[i]);
    tie.x_in_b.push_back(x_in_b[i]);
  }
  return tie;
}

std::vector<std::pair<int, int>> CandidatePairs(const AlignGraph& graph, const AlignState& state, const std::vector<bool>& takes_part,
                                                const ContentOptions& options) {
  std::vector<int> members;
  for (std::size_t s = 0; s < graph.scenes.size(); ++s) {
    if (takes_part[s] && state.scenes[s].piece >= 0) members.push_back(static_cast<int>(s));
  }
  std::set<std::pair<int, int>> pairs;
  AddPairsWithinPieces(graph, state, members, options, pairs);
  AddPairsBetweenPieces(state, members, options, pairs);
  return {pairs.begin(), pairs.end()};
}

}  // namespace trem::align
