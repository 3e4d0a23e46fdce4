// Goal: log lines carry their fields in both formats, and whatever bytes they hold stay on one line of valid JSON. Method: stderr captured.
#include "mosaic/base/log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace trem {
namespace {

using ::testing::EndsWith;
using ::testing::HasSubstr;

std::string Logged(const std::string& format, const std::string& message, std::initializer_list<LogField> fields) {
  ::testing::internal::CaptureStderr();
  EXPECT_TRUE(ConfigureLog("program", "info", format).ok());
  LogWith(spdlog::level::info, message, fields);
  LogWith(spdlog::level::debug, "below the level", {});
  spdlog::default_logger()->flush();
  return ::testing::internal::GetCapturedStderr();
}

TEST(LogTest, TextPutsFieldsBehindTheMessage) {
  const std::string line = Logged("text", "task ended", {{"job", "town-1"}, {"attempt", "2"}});
  EXPECT_THAT(line, EndsWith("Z info [program] task ended job=town-1 attempt=2\n"));
}

TEST(LogTest, JsonIsOneObjectALine) {
  const std::string line = Logged("json", "a \"quote\", a\nnewline and \xff", {{"job", "town-1"}, {"worker", "w\\1"}});
  EXPECT_EQ(std::count(line.begin(), line.end(), '\n'), 1);
  const auto json = nlohmann::json::parse(line);
  EXPECT_EQ(json["level"], "info");
  EXPECT_EQ(json["program"], "program");
  EXPECT_THAT(json["message"].get<std::string>(), HasSubstr("a \"quote\", a\nnewline and"));
  EXPECT_EQ(json["job"], "town-1");
  EXPECT_EQ(json["worker"], "w\\1");
  EXPECT_THAT(json["time"].get<std::string>(), EndsWith("Z"));
}

TEST(LogTest, RefusesAnotherFormat) { EXPECT_THAT(ConfigureLog("program", "info", "xml").message(), HasSubstr("expected text or json")); }

}  // namespace
}  // namespace trem
