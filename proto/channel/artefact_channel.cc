#include "proto/channel/artefact_channel.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <optional>
#include <utility>

#include "mosaic/base/digest.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

using std::chrono::milliseconds;

constexpr std::uint64_t kChunkBytes = 1 << 20;
constexpr std::uint64_t kCreditChunks = 8;
constexpr milliseconds kSilenceMax{5000};
constexpr int kSilencesMax = 6;

// Owns a file; -1 when it could not be opened.
class File {
 public:
  File(const fs::path& path, int flags) : path_(path), fd_(::open(path.c_str(), flags | O_CLOEXEC, 0644)) {}
  ~File() {
    if (fd_ >= 0) ::close(fd_);
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  Status Check() const { return fd_ >= 0 ? Status() : FromErrno("cannot open " + path_.string(), errno); }
  Status WriteAt(std::uint64_t offset, const std::string& data) const {
    for (std::size_t done = 0; done < data.size();) {
      const ssize_t count = ::pwrite(fd_, data.data() + done, data.size() - done, static_cast<off_t>(offset + done));
      if (count < 0 && errno != EINTR) return FromErrno("cannot write " + path_.string(), errno);
      if (count > 0) done += static_cast<std::size_t>(count);
    }
    return {};
  }
  Result<std::string> ReadAt(std::uint64_t offset, std::size_t bytes) const {
    std::string data(bytes, '\0');
    for (std::size_t done = 0; done < bytes;) {
      const ssize_t count = ::pread(fd_, data.data() + done, bytes - done, static_cast<off_t>(offset + done));
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) return FromErrno("cannot read " + path_.string(), errno);
      if (count == 0) return Corrupt(path_.string() + " became shorter while it was read");
      done += static_cast<std::size_t>(count);
    }
    return data;
  }

 private:
  fs::path path_;
  int fd_;
};

std::string HostOf(const std::string& endpoint) { return endpoint.substr(0, endpoint.rfind(':')); }

// The data lane as this side reaches it.
std::string Reachable(const std::string& data_lane, const std::string& coordinator) {
  const std::string host = HostOf(data_lane);
  if (host != "tcp://0.0.0.0" && host != "tcp://[::]") return data_lane;
  return HostOf(coordinator) + data_lane.substr(data_lane.rfind(':'));
}

Status FromReply(const v1::ErrorReply& error) {
  const auto code = static_cast<StatusCode>(error.status_code());
  return {code == StatusCode::kOk ? StatusCode::kFailed : code, error.message()};
}

}  // namespace

ArtefactChannel::ArtefactChannel(std::string coordinator, const ChannelOptions& options)
    : coordinator_(std::move(coordinator)), options_(options) {}

ArtefactChannel::~ArtefactChannel() = default;

Result<v1::Envelope> ArtefactChannel::Ask(DealerChannel* channel, const v1::Envelope& question) const {
  TREM_RETURN_IF_ERROR(channel->Send(question, kSilenceMax));
  const auto deadline = std::chrono::steady_clock::now() + kSilenceMax;
  while (std::chrono::steady_clock::now() < deadline) {
    TREM_ASSIGN_OR_RETURN(const std::optional<v1::Envelope> answer, channel->Receive(milliseconds(100)));
    if (answer && answer->has_error()) return FromReply(answer->error());
    if (answer && !answer->has_heartbeat()) return *answer;
    if (on_chunk_ && !on_chunk_()) return Cancelled("stopped as asked");
  }
  return Unavailable("the coordinator at " + coordinator_ + " is silent");
}

Status ArtefactChannel::Connect() {
  if (channel_) return {};
  TREM_ASSIGN_OR_RETURN(const auto control, DealerChannel::Connect(coordinator_, options_));
  v1::Envelope question;
  question.mutable_get_data_lane();
  TREM_ASSIGN_OR_RETURN(const v1::Envelope answer, Ask(control.get(), question));
  if (!answer.has_data_lane()) return Corrupt("the coordinator at " + coordinator_ + " did not say where its data lane is");
  TREM_ASSIGN_OR_RETURN(channel_, DealerChannel::Connect(Reachable(answer.data_lane().endpoint(), coordinator_), options_));
  return {};
}

Status ArtefactChannel::Send(const v1::Envelope& envelope) {
  TREM_RETURN_IF_ERROR(Connect());
  const Status sent = channel_->Send(envelope, kSilenceMax);
  if (!sent.ok()) channel_.reset();
  return sent;
}

Result<std::optional<v1::Envelope>> ArtefactChannel::Receive(const std::string& sha256, int* silences) {
  const auto deadline = std::chrono::steady_clock::now() + kSilenceMax;
  while (channel_ && std::chrono::steady_clock::now() < deadline) {
    if (on_chunk_ && !on_chunk_()) return Cancelled("stopped as asked");
    const Result<std::optional<v1::Envelope>> answer = channel_->Receive(milliseconds(100));
    if (!answer.ok() || !answer->has_value()) continue;
    const v1::Envelope& envelope = **answer;
    if (envelope.has_error()) {
      // What else was on its way is refused, too, and those answers would be taken for the next artefact's.
      const Status refusal = FromReply(envelope.error());
      channel_.reset();
      return refusal;
    }
    // Late answers about another artefact are of no use any more.
    if (envelope.chunk().sha256() != sha256 && envelope.put_reply().sha256() != sha256) continue;
    *silences = 0;
    return *answer;
  }
  channel_.reset();  // What was on its way is lost or late; over a new connection nothing can be confused.
  if (++*silences >= kSilencesMax) return Unavailable("the coordinator's data lane is silent");
  return std::optional<v1::Envelope>();
}

Status ArtefactChannel::Fetch(const ArtefactRef& ref, const fs::path& path) {
  const File file(path, O_WRONLY | O_CREAT);
  TREM_RETURN_IF_ERROR(file.Check());
  std::error_code error;
  std::uint64_t received = fs::file_size(path, error);
  if (error || received > ref.bytes) received = 0;
  std::uint64_t requested = received;
  int silences = 0;
  while (received < ref.bytes) {
    for (; requested < ref.bytes && requested < received + kCreditChunks * kChunkBytes; requested += kChunkBytes) {
      v1::Envelope envelope;
      envelope.mutable_get_chunk()->set_sha256(ref.sha256);
      envelope.mutable_get_chunk()->set_offset(requested);
      envelope.mutable_get_chunk()->set_bytes_max(static_cast<std::uint32_t>(std::min(kChunkBytes, ref.bytes - requested)));
      if (!Send(envelope).ok()) break;
    }
    TREM_ASSIGN_OR_RETURN(const std::optional<v1::Envelope> answer, Receive(ref.sha256, &silences));
    if (!answer) {
      requested = received;
      continue;
    }
    const v1::Chunk& chunk = answer->chunk();
    if (chunk.offset() != received || chunk.data().empty() || chunk.data().size() > ref.bytes - received) continue;
    if (Sha256Hex(chunk.data()) != chunk.data_sha256()) {
      channel_.reset();
      requested = received;
      if (++silences >= kSilencesMax) return Corrupt("artefact " + ref.name + ": chunks arrive damaged");
      continue;
    }
    TREM_RETURN_IF_ERROR(file.WriteAt(received, chunk.data()));
    received += chunk.data().size();
  }
  if (::truncate(path.c_str(), static_cast<off_t>(ref.bytes)) != 0) return FromErrno("cannot cut " + path.string(), errno);
  return {};
}

Status ArtefactChannel::Deliver(const ArtefactRef& ref, const fs::path& path) {
  const File file(path, O_RDONLY);
  TREM_RETURN_IF_ERROR(file.Check());
  const auto send = [&](std::uint64_t offset, std::string data) {
    v1::Envelope envelope;
    v1::PutChunk* put = envelope.mutable_put_chunk();
    put->set_sha256(ref.sha256);
    put->set_bytes(ref.bytes);
    put->set_offset(offset);
    put->set_data_sha256(Sha256Hex(data));
    put->set_data(std::move(data));
    return Send(envelope);
  };
  std::uint64_t sent = 0;
  std::uint64_t accepted = 0;
  int silences = 0;
  bool asks = true;  // First whether it is there already, and again after every silence.
  for (;;) {
    if (asks) (void)send(0, {}).ok();
    for (; !asks && sent < ref.bytes && sent < accepted + kCreditChunks * kChunkBytes; sent += kChunkBytes) {
      TREM_ASSIGN_OR_RETURN(std::string data, file.ReadAt(sent, static_cast<std::size_t>(std::min(kChunkBytes, ref.bytes - sent))));
      if (!send(sent, std::move(data)).ok()) break;
    }
    TREM_ASSIGN_OR_RETURN(const std::optional<v1::Envelope> answer, Receive(ref.sha256, &silences));
    if (!answer) {
      asks = true;
      continue;
    }
    const v1::PutReply& reply = answer->put_reply();
    if (reply.is_stored()) return {};
    if (asks || reply.next_offset() < accepted) {
      asks = false;
      sent = accepted = reply.next_offset();  // The other side lost something.
    } else {
      accepted = reply.next_offset();
      sent = std::max(sent, accepted);  // Another who has the same artefact may have brought more of it.
    }
  }
}

}  // namespace trem
