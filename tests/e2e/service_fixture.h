#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "tests/e2e/run_fixture.h"

namespace trem::testing {

// A coordinator over TCP on loopback, with its state, store and commands.
class ServiceTest : public ::testing::Test {
 protected:
  // Starts the coordinator with these options besides, and waits until it listens.
  void Start(const std::vector<std::string>& more = {});
  // Runs `trem` with this coordinator named.
  Completed Trem(std::vector<std::string> arguments, const std::vector<std::string>& environment = {}) const;
  // A worker that shares the store.
  std::unique_ptr<Subprocess> Worker(const std::vector<std::string>& more = {}) const;
  // Submits a sortie of `frame_count` frames.
  void Submit(const std::string& job_id, int frame_count);

  RunFixture fixture_;
  std::filesystem::path ready_ = fixture_.folder() / "ready";
  std::filesystem::path store_ = fixture_.folder() / "store";
  std::string bind_ = "tcp://127.0.0.1:*";
  std::unique_ptr<Subprocess> coordinator_;
  std::string endpoint_;
};

}  // namespace trem::testing
