#include "proto/channel/artefact_channel.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <utility>

#include "mosaic/base/digest.h"
#include "mosaic/base/open_file.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kSilenceMax{5000};
constexpr int kSilencesMax = 6;
constexpr int kDamagedMax = 6;  // Tries of one chunk.

// The digest of the first `bytes` bytes of a file.
Status DigestBeginning(const OpenFile& file, std::uint64_t bytes, Sha256* digest) {
  const auto block = std::make_unique_for_overwrite<char[]>(kChunkBytes);
  for (std::uint64_t offset = 0; offset < bytes;) {
    const std::span<char> piece(block.get(), std::min(bytes - offset, kChunkBytes));
    TREM_RETURN_IF_ERROR(file.ReadAt(offset, piece));
    digest->Update({piece.data(), piece.size()});
    offset += piece.size();
  }
  return {};
}

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
    : coordinator_(std::move(coordinator)), options_(options) {
  KeepFreedChunks();
}

ArtefactChannel::~ArtefactChannel() = default;

Result<v1::Envelope> ArtefactChannel::AskControl(DealerChannel* channel, const v1::Envelope& question) const {
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
  TREM_ASSIGN_OR_RETURN(const v1::Envelope answer, AskControl(control.get(), question));
  if (!answer.has_data_lane()) return Corrupt("the coordinator at " + coordinator_ + " did not say where its data lane is");
  TREM_ASSIGN_OR_RETURN(channel_, DealerChannel::Connect(Reachable(answer.data_lane().endpoint(), coordinator_), options_));
  return {};
}

Status ArtefactChannel::Send(const v1::Envelope& envelope, Payload payload) {
  TREM_RETURN_IF_ERROR(Connect());
  const Status sent = channel_->Send(envelope, kSilenceMax, std::move(payload));
  if (!sent.ok()) channel_.reset();
  return sent;
}

Result<std::optional<v1::Envelope>> ArtefactChannel::Receive(const std::string& sha256, int* silences, Payload* payload) {
  const auto deadline = std::chrono::steady_clock::now() + kSilenceMax;
  while (channel_ && std::chrono::steady_clock::now() < deadline) {
    if (on_chunk_ && !on_chunk_()) return Cancelled("stopped as asked");
    const Result<std::optional<v1::Envelope>> answer = channel_->Receive(milliseconds(100), payload);
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

void ArtefactChannel::Ask(const ArtefactRef& ref, std::uint64_t received, std::uint64_t* requested) {
  for (; *requested < ref.bytes && *requested < received + kCreditChunks * kChunkBytes; *requested += kChunkBytes) {
    v1::Envelope envelope;
    envelope.mutable_get_chunk()->set_sha256(ref.sha256);
    envelope.mutable_get_chunk()->set_offset(*requested);
    envelope.mutable_get_chunk()->set_bytes_max(static_cast<std::uint32_t>(std::min(kChunkBytes, ref.bytes - *requested)));
    if (!Send(envelope, {}).ok()) return;
  }
}

Result<std::string> ArtefactChannel::Fetch(const ArtefactRef& ref, const fs::path& path) {
  TREM_ASSIGN_OR_RETURN(const OpenFile file, OpenFile::Open(path, O_RDWR | O_CREAT));
  TREM_ASSIGN_OR_RETURN(std::uint64_t received, file.Size());
  if (received > ref.bytes) received = 0;
  Sha256 digest;
  TREM_RETURN_IF_ERROR(DigestBeginning(file, received, &digest));
  std::uint64_t requested = received;
  int silences = 0;
  int damaged = 0;
  while (received < ref.bytes) {
    Ask(ref, received, &requested);
    Payload payload;
    TREM_ASSIGN_OR_RETURN(const std::optional<v1::Envelope> answer, Receive(ref.sha256, &silences, &payload));
    if (!answer) {
      requested = received;
      continue;
    }
    const std::string_view data = payload.bytes();
    if (answer->chunk().offset() != received || data.empty() || data.size() > ref.bytes - received) continue;
    if (Xxh3(data) != answer->chunk().data_xxh3()) {
      channel_.reset();
      requested = received;
      if (++damaged >= kDamagedMax) return Corrupt("artefact " + ref.name + ": chunks arrive damaged");
      continue;
    }
    damaged = 0;
    digest.Update(data);
    TREM_RETURN_IF_ERROR(file.WriteAt(received, data));
    received += data.size();
  }
  if (::truncate(path.c_str(), static_cast<off_t>(ref.bytes)) != 0) return FromErrno("cannot cut " + path.string(), errno);
  return digest.FinishHex();
}

Status ArtefactChannel::Deliver(const ArtefactRef& ref, const fs::path& path) {
  TREM_ASSIGN_OR_RETURN(const OpenFile file, OpenFile::Open(path, O_RDONLY));
  const auto send = [&](std::uint64_t offset, Payload data) {
    v1::Envelope envelope;
    v1::PutChunk* put = envelope.mutable_put_chunk();
    put->set_sha256(ref.sha256);
    put->set_bytes(ref.bytes);
    put->set_offset(offset);
    put->set_data_xxh3(Xxh3(data.bytes()));
    return Send(envelope, std::move(data));
  };
  std::uint64_t sent = 0;
  std::uint64_t accepted = 0;
  int silences = 0;
  bool asks = true;  // First whether it is there already, and again after every silence.
  for (;;) {
    if (asks) (void)send(0, {}).ok();
    for (; !asks && sent < ref.bytes && sent < accepted + kCreditChunks * kChunkBytes; sent += kChunkBytes) {
      Payload data(std::min(kChunkBytes, ref.bytes - sent));
      TREM_RETURN_IF_ERROR(file.ReadAt(sent, {data.data(), data.size()}));
      if (!send(sent, std::move(data)).ok()) break;
    }
    Payload none;
    TREM_ASSIGN_OR_RETURN(const std::optional<v1::Envelope> answer, Receive(ref.sha256, &silences, &none));
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
