#pragma once

#include <cstdint>

#include "proto/trem/v1/task.pb.h"

namespace trem::bench {

// Tasks that do nothing, for measurements of the service around them: what they would have made, without making it. INGEST sees a sortie
// that `testing::FakeSortie` cuts into `window_count` windows (two ROIs side by side), ENHANCE gives its window and four scenes, ALIGN a
// tenth as many tiles.
v1::TaskResult NoOpResult(const v1::TaskSpec& spec, std::uint32_t window_count);

}  // namespace trem::bench
