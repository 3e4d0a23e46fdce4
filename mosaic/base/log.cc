#include "mosaic/base/log.h"

#include <fmt/chrono.h>
#include <spdlog/sinks/stdout_sinks.h>

#include <chrono>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

namespace trem {
namespace {

// Between message, keys and values of a record on its way to the formatter. Control characters do not occur in them otherwise.
constexpr char kSeparator = '\x1f';

std::vector<std::string_view> Split(std::string_view payload) {
  std::vector<std::string_view> parts;
  for (std::size_t end = 0; (end = payload.find(kSeparator)) != std::string_view::npos; payload.remove_prefix(end + 1)) {
    parts.push_back(payload.substr(0, end));
  }
  parts.push_back(payload);
  return parts;
}

// "2026-01-31T12:00:00.123Z".
std::string Timestamp(std::chrono::system_clock::time_point time) {
  const auto since = std::chrono::duration_cast<std::chrono::milliseconds>(time.time_since_epoch());
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(std::chrono::system_clock::to_time_t(time)), since.count() % 1000);
}

std::string_view View(const spdlog::string_view_t& text) { return {text.data(), text.size()}; }

class TextFormatter final : public spdlog::formatter {
 public:
  void format(const spdlog::details::log_msg& record, spdlog::memory_buf_t& out) override {
    const auto parts = Split(View(record.payload));
    std::string line = fmt::format("{} {} [{}] {}", Timestamp(record.time), View(spdlog::level::to_string_view(record.level)),
                                   View(record.logger_name), parts[0]);
    for (std::size_t i = 1; i + 1 < parts.size(); i += 2) line += fmt::format(" {}={}", parts[i], parts[i + 1]);
    line += '\n';
    out.append(line.data(), line.data() + line.size());
  }
  std::unique_ptr<spdlog::formatter> clone() const override { return std::make_unique<TextFormatter>(); }
};

class JsonFormatter final : public spdlog::formatter {
 public:
  void format(const spdlog::details::log_msg& record, spdlog::memory_buf_t& out) override {
    const auto parts = Split(View(record.payload));
    nlohmann::ordered_json json = {{"time", Timestamp(record.time)},
                                   {"level", View(spdlog::level::to_string_view(record.level))},
                                   {"program", View(record.logger_name)},
                                   {"message", parts[0]}};
    for (std::size_t i = 1; i + 1 < parts.size(); i += 2) json[std::string(parts[i])] = parts[i + 1];
    const std::string line = json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + '\n';
    out.append(line.data(), line.data() + line.size());
  }
  std::unique_ptr<spdlog::formatter> clone() const override { return std::make_unique<JsonFormatter>(); }
};

}  // namespace

Status ConfigureLog(const std::string& program, const std::string& level, const std::string& format) {
  std::unique_ptr<spdlog::formatter> formatter;
  if (format == "text") formatter = std::make_unique<TextFormatter>();
  if (format == "json") formatter = std::make_unique<JsonFormatter>();
  if (!formatter) return InvalidInput("log format '" + format + "' is not known; expected text or json");
  auto logger = std::make_shared<spdlog::logger>(program, std::make_shared<spdlog::sinks::stderr_sink_mt>());
  logger->set_formatter(std::move(formatter));
  const auto parsed = spdlog::level::from_str(level);
  logger->set_level(parsed == spdlog::level::off && level != "off" ? spdlog::level::info : parsed);
  spdlog::set_default_logger(std::move(logger));
  return {};
}

void LogWith(spdlog::level::level_enum level, std::string_view message, std::initializer_list<LogField> fields) {
  if (!spdlog::should_log(level)) return;
  std::string payload(message);
  for (const LogField& field : fields) payload += kSeparator + std::string(field.key) + kSeparator + field.value;
  spdlog::log(level, "{}", payload);
}

}  // namespace trem
