#include "coordinator/store/job_log.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "mosaic/base/file.h"

namespace trem {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kTextBytesMax = 2048;
constexpr std::size_t kPageBytesMax = std::size_t{256} << 10;
constexpr std::size_t kFieldCount = 8;
// As much of a task's key as tells tasks apart.
constexpr std::size_t kKeyChars = 16;
// Jobs whose numbers are kept in memory; more are looked up in their files again.
constexpr std::size_t kJobsInMemoryMax = 4096;

// One line, printable: control characters (tabs and line ends among them) become spaces, bytes that are no UTF-8 question marks.
std::string Printable(std::string_view text) {
  std::string out;
  out.reserve(std::min(text.size(), kTextBytesMax));
  for (std::size_t i = 0; i < text.size() && out.size() < kTextBytesMax;) {
    const auto byte = static_cast<unsigned char>(text[i]);
    const std::size_t length = byte < 0x80                   ? 1
                               : byte >= 0xc2 && byte < 0xe0 ? 2
                               : byte >= 0xe0 && byte < 0xf0 ? 3
                               : byte >= 0xf0 && byte < 0xf5 ? 4
                                                             : 0;
    bool is_whole = length > 0 && i + length <= text.size();
    for (std::size_t k = 1; is_whole && k < length; ++k) is_whole = (static_cast<unsigned char>(text[i + k]) & 0xc0) == 0x80;
    // The first 32 code points after ASCII are control characters too; overlong forms and surrogates are no characters.
    if (is_whole && length == 2 && byte == 0xc2 && static_cast<unsigned char>(text[i + 1]) < 0xa0) is_whole = false;
    if (is_whole && length == 3) {
      const auto second = static_cast<unsigned char>(text[i + 1]);
      is_whole = !(byte == 0xe0 && second < 0xa0) && !(byte == 0xed && second >= 0xa0);
    }
    if (is_whole && length == 4) {
      const auto second = static_cast<unsigned char>(text[i + 1]);
      is_whole = !(byte == 0xf0 && second < 0x90) && !(byte == 0xf4 && second >= 0x90);
    }
    if (!is_whole) {
      out += '?';
      ++i;
    } else if (length == 1) {
      out += byte < 0x20 || byte == 0x7f ? ' ' : static_cast<char>(byte);
      ++i;
    } else {
      out.append(text.substr(i, length));
      i += length;
    }
  }
  return out;
}

std::string LineOf(const v1::LogLine& line) {
  std::string text =
      std::to_string(line.number()) + '\t' + std::to_string(line.time_ms()) + '\t' + (line.warning() ? "warning" : "info") + '\t';
  text += Printable(line.task()) + '\t' + Printable(line.task_key().substr(0, kKeyChars)) + '\t' + std::to_string(line.attempt()) + '\t';
  text += Printable(line.worker_id()) + '\t' + Printable(line.text()) + '\n';
  return text;
}

template <typename Number>
bool Parse(std::string_view text, Number* number) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), *number);
  return error == std::errc() && end == text.data() + text.size();
}

// Nullopt for half a line, or one that somebody has edited.
std::optional<v1::LogLine> ParseLine(std::string_view text) {
  std::array<std::string_view, kFieldCount> fields;
  for (std::size_t i = 0; i < kFieldCount; ++i) {
    const std::size_t end = i + 1 < kFieldCount ? text.find('\t') : text.size();
    if (end == std::string_view::npos) return std::nullopt;
    fields[i] = text.substr(0, end);
    text.remove_prefix(std::min(text.size(), end + 1));
  }
  v1::LogLine line;
  std::uint64_t number = 0, time_ms = 0;
  std::uint32_t attempt = 0;
  if (!Parse(fields[0], &number) || !Parse(fields[1], &time_ms) || !Parse(fields[5], &attempt)) return std::nullopt;
  line.set_number(number);
  line.set_time_ms(time_ms);
  line.set_warning(fields[2] == "warning");
  line.set_task(Printable(fields[3]));
  line.set_task_key(Printable(fields[4]));
  line.set_attempt(attempt);
  line.set_worker_id(Printable(fields[6]));
  line.set_text(Printable(fields[7]));
  return line;
}

bool EqualsIgnoringCase(std::string_view a, std::string_view b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](unsigned char x, unsigned char y) { return std::tolower(x) == std::tolower(y); });
}

bool IsWanted(const v1::LogLine& line, const v1::GetLog& get) {
  const bool is_task = get.task().empty() || EqualsIgnoringCase(line.task(), get.task()) ||
                       (get.task().size() >= 4 && line.task_key().starts_with(get.task().substr(0, kKeyChars)));
  return is_task && (get.attempt() == 0 || line.attempt() == get.attempt()) &&
         (get.worker_id().empty() || line.worker_id() == get.worker_id());
}

// Calls `visit` with every line whose number is above `after`.
template <typename Visit>
void ForEachLine(std::string_view text, std::uint64_t after, Visit visit) {
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    if (end == std::string_view::npos) return;
    std::uint64_t number = 0;
    const std::string_view line_text = text.substr(0, end);
    if (Parse(line_text.substr(0, line_text.find('\t')), &number) && number > after) {
      if (auto line = ParseLine(line_text)) visit(*std::move(line));
    }
    text.remove_prefix(end + 1);
  }
}

}  // namespace

JobLog::JobLog(fs::path folder, const JobLogOptions& options) : folder_(std::move(folder)), options_(options) {}

fs::path JobLog::PathOf(const std::string& job_id, bool older) const { return folder_ / (job_id + (older ? ".log.1" : ".log")); }

JobLog::Job& JobLog::Find(const std::string& job_id) {
  if (const auto known = jobs_.find(job_id); known != jobs_.end()) return known->second;
  if (jobs_.size() >= kJobsInMemoryMax) Flush();
  if (jobs_.size() >= kJobsInMemoryMax) jobs_.clear();
  Job job;
  for (const bool older : {true, false}) {
    const auto text = ReadFile(PathOf(job_id, older), options_.job_bytes_max);
    if (!text.ok()) continue;
    ForEachLine(*text, 0, [&](const v1::LogLine& line) { job.next_number = std::max(job.next_number, line.number() + 1); });
    if (!older) job.bytes = text->size();
  }
  return jobs_.emplace(job_id, std::move(job)).first->second;
}

void JobLog::Append(const std::string& job_id, v1::LogLine line) {
  Job& job = Find(job_id);
  line.set_number(job.next_number++);
  job.unwritten += LineOf(line);
  ++job.unwritten_count;
  unwritten_.insert(job_id);
  if (job.unwritten.size() > options_.job_bytes_max / 8) Write(job_id, &job);
}

void JobLog::Flush() {
  for (const std::string& job_id : std::exchange(unwritten_, {})) Write(job_id, &jobs_.at(job_id));
  // Looked at now and then, and once after the start.
  if (is_total_known_ && written_bytes_ < options_.bytes_max / 16) return;
  RemoveOldest();
  is_total_known_ = true;
  written_bytes_ = 0;
}

void JobLog::Write(const std::string& job_id, Job* job) {
  const std::string text = std::exchange(job->unwritten, {});
  if (text.empty()) return;
  const std::uint64_t count = std::exchange(job->unwritten_count, 0);
  std::error_code error;
  if (job->bytes + text.size() > options_.job_bytes_max / 2) {
    fs::rename(PathOf(job_id, false), PathOf(job_id, true), error);
    job->bytes = 0;
  }
  const fs::path path = PathOf(job_id, false);
  int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  if (fd < 0 && errno == ENOENT && MakeDirectories(folder_).ok())
    fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  const ssize_t written = fd < 0 ? -1 : ::write(fd, text.data(), text.size());
  if (fd >= 0) ::close(fd);
  if (written > 0) job->bytes += static_cast<std::uint64_t>(written);
  if (written != static_cast<ssize_t>(text.size())) lost_count_ += count;
  written_bytes_ += text.size();
}

void JobLog::RemoveOldest() {
  struct File {
    fs::file_time_type time;
    fs::path path;
    std::uint64_t bytes = 0;
  };
  std::vector<File> files;
  std::uint64_t total = 0;
  std::error_code error;
  for (fs::directory_iterator it(folder_, error), end; !error && it != end; it.increment(error)) {
    std::error_code ignored;
    if (!it->is_regular_file(ignored)) continue;
    files.push_back({it->last_write_time(ignored), it->path(), it->file_size(ignored)});
    total += files.back().bytes;
  }
  std::sort(files.begin(), files.end(), [](const File& a, const File& b) { return a.time < b.time; });
  for (const File& file : files) {
    if (total <= options_.bytes_max) return;
    fs::remove(file.path, error);
    total -= file.bytes;
    if (const auto job = jobs_.find(file.path.stem().string()); file.path.extension() == ".log" && job != jobs_.end())
      job->second.bytes = 0;
  }
}

v1::LogPage JobLog::Page(const v1::GetLog& get) {
  Flush();
  std::vector<v1::LogLine> lines;
  std::uint64_t newest = get.after();
  if (const auto known = jobs_.find(get.job_id()); known != jobs_.end() && known->second.next_number <= newest + 1) {
    v1::LogPage nothing_new;
    nothing_new.set_next_after(newest);
    nothing_new.set_is_last(true);
    return nothing_new;
  }
  for (const bool older : {true, false}) {
    const auto text = ReadFile(PathOf(get.job_id(), older), options_.job_bytes_max);
    if (!text.ok()) continue;
    ForEachLine(*text, get.after(), [&](v1::LogLine line) {
      newest = std::max(newest, line.number());
      if (IsWanted(line, get)) lines.push_back(std::move(line));
    });
  }
  std::size_t bytes = 0;
  const auto fits = [&](const v1::LogLine& line) { return (bytes += line.ByteSizeLong() + 8) <= kPageBytesMax; };
  auto begin = lines.begin();
  auto end = lines.end();
  if (get.newest()) {
    begin = lines.end();
    while (begin != lines.begin() && fits(*std::prev(begin))) --begin;
  } else {
    end = std::find_if_not(lines.begin(), lines.end(), fits);
  }
  v1::LogPage page;
  page.set_is_last(end == lines.end());
  page.set_next_after(end == lines.end() ? newest : std::prev(end)->number());
  for (auto line = begin; line != end; ++line) *page.add_lines() = std::move(*line);
  return page;
}

}  // namespace trem
