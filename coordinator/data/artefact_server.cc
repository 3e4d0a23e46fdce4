#include "coordinator/data/artefact_server.h"

#include <fcntl.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <system_error>

#include "mosaic/base/file.h"
#include "mosaic/base/open_file.h"
#include "proto/channel/artefact_channel.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr std::ptrdiff_t kUploadsOfUserMax = 256;
// So long what has arrived waits for the rest.
constexpr std::int64_t kUploadIdleMsMax = 3'600'000;
constexpr std::uint64_t kBytesCheckedMax = std::uint64_t{1} << 30;
constexpr std::int64_t kForgetIntervalMs = 10'000;
constexpr std::int64_t kCountIntervalMs = 500;

std::int64_t NowMs() {
  return std::chrono::duration_cast<std::chrono::milliseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

std::uint64_t BytesOfObjects(const fs::path& root) {
  std::uint64_t total = 0;
  std::error_code error;
  for (fs::recursive_directory_iterator it(root / "objects", error), end; !error && it != end; it.increment(error)) {
    std::error_code gone;
    const std::uint64_t bytes = it->is_regular_file(gone) ? it->file_size(gone) : 0;
    if (!gone) total += bytes;
  }
  return total;
}

}  // namespace

ArtefactServer::ArtefactServer(std::unique_ptr<RouterChannel> channel, ArtefactStore store, const ArtefactServerOptions& options)
    : channel_(std::move(channel)), store_(std::move(store)), options_(options) {}

Result<std::unique_ptr<ArtefactServer>> ArtefactServer::Start(const std::string& endpoint, const ChannelOptions& channel_options,
                                                              ArtefactStore store, const ArtefactServerOptions& options) {
  ChannelOptions own = channel_options;
  own.limits.body_bytes_max = std::size_t{8} << 20;  // A chunk has at most half of that.
  // Who asks for far more than his credit, or does not take what he asked for, fills no memory here. libzmq learns only now and then how
  // much of a queue was taken: one of the credit's own size would lose answers.
  own.messages_unread_max = own.messages_unsent_max = 4 * static_cast<int>(kCreditChunks);
  KeepFreedChunks();
  TREM_ASSIGN_OR_RETURN(std::unique_ptr<RouterChannel> channel, RouterChannel::Bind(endpoint, own));
  std::unique_ptr<ArtefactServer> server(new ArtefactServer(std::move(channel), std::move(store), options));
  if (options.store_bytes_max > 0) server->store_bytes_ = BytesOfObjects(server->store_.root());
  server->thread_ = std::thread([self = server.get()] { self->Serve(); });
  return server;
}

ArtefactServer::~ArtefactServer() {
  stop_ = true;
  channel_->Wake();
  if (thread_.joinable()) thread_.join();
  for (const auto& [digest, upload] : uploads_) {
    std::error_code ignored;
    fs::remove(upload.path, ignored);
  }
}

ChannelCounters ArtefactServer::counters() const {
  const std::lock_guard lock(counters_mutex_);
  return counters_;
}

void ArtefactServer::Serve() {
  std::int64_t next_forget_ms = 0, next_count_ms = 0;
  while (!stop_) {
    const auto incoming = channel_->Poll(std::chrono::milliseconds(500));
    const std::int64_t now_ms = NowMs();
    if (now_ms >= next_forget_ms) {
      ForgetOldUploads(now_ms);
      next_forget_ms = now_ms + kForgetIntervalMs;
    }
    if (now_ms >= next_count_ms) {
      const std::lock_guard lock(counters_mutex_);
      counters_ = channel_->counters();
      next_count_ms = now_ms + kCountIntervalMs;
    }
    if (!incoming) continue;
    Payload payload;
    Result<v1::Envelope> answer = Answer(*incoming, &payload);
    if (!answer.ok()) {
      v1::Envelope refusal;
      refusal.mutable_error()->set_status_code(static_cast<std::uint32_t>(answer.status().code()));
      refusal.mutable_error()->set_message(answer.status().message().substr(0, 4096));
      answer = std::move(refusal);
    }
    channel_->Send(incoming->peer, *answer, std::move(payload));  // What does not get through is asked for again.
  }
}

Result<v1::Envelope> ArtefactServer::Answer(const RouterChannel::Incoming& incoming, Payload* payload) {
  if (!incoming.envelope.ok()) return incoming.envelope.status();
  if (incoming.envelope->has_get_chunk()) return OnGet(incoming.envelope->get_chunk(), payload);
  if (incoming.envelope->has_put_chunk()) return OnPut(incoming.user, incoming.envelope->put_chunk(), incoming.payload.bytes());
  return InvalidInput("the data lane takes and gives chunks of artefacts; everything else goes to the control lane");
}

Result<v1::Envelope> ArtefactServer::OnGet(const v1::GetChunk& get, Payload* payload) {
  ArtefactRef ref{"", get.sha256(), 0};
  TREM_ASSIGN_OR_RETURN(const fs::path object, store_.Find(get.sha256(), &ref.bytes));
  if (get.offset() > ref.bytes || (get.offset() == ref.bytes && ref.bytes > 0)) {
    return InvalidInput("artefact " + get.sha256() + " has " + std::to_string(ref.bytes) + " bytes; offset " +
                        std::to_string(get.offset()) + " was asked for");
  }
  TREM_ASSIGN_OR_RETURN(const OpenFile file, OpenFile::Open(object, O_RDONLY | O_NOFOLLOW));
  Payload data(std::min<std::uint64_t>(get.bytes_max(), ref.bytes - get.offset()));
  TREM_RETURN_IF_ERROR(file.ReadAt(get.offset(), {data.data(), data.size()}));
  bytes_sent_ += data.size();
  v1::Envelope answer;
  v1::Chunk* chunk = answer.mutable_chunk();
  chunk->set_sha256(get.sha256());
  chunk->set_offset(get.offset());
  chunk->set_data_xxh3(Xxh3(data.bytes()));
  *payload = std::move(data);
  return answer;
}

Status ArtefactServer::CheckRoom(std::uint64_t bytes) const {
  if (options_.store_bytes_max == 0) return {};
  std::uint64_t taken = store_bytes_;
  for (const auto& [digest, upload] : uploads_) taken += upload.bytes;
  if (bytes <= options_.store_bytes_max && taken <= options_.store_bytes_max - bytes) return {};
  return Exhausted("the artefact store holds " + std::to_string(taken) + " of at most " + std::to_string(options_.store_bytes_max) +
                   " bytes, and " + std::to_string(bytes) + " more would come; raise --store-bytes-max or remove old jobs' work");
}

bool ArtefactServer::IsStored(const v1::PutChunk& put) const {
  const ArtefactRef ref{"upload", put.sha256(), put.bytes()};
  // What was damaged here has to be taken in again. A long one is a sortie's input, and reading it would keep everybody else waiting:
  // its readers check it.
  return put.bytes() <= kBytesCheckedMax ? store_.Verify(ref).ok() : store_.Locate(ref).ok();
}

Result<ArtefactServer::Upload*> ArtefactServer::UploadOf(const std::string& user, const v1::PutChunk& put) {
  if (const auto known = uploads_.find(put.sha256()); known != uploads_.end()) return &known->second;
  TREM_RETURN_IF_ERROR(CheckRoom(put.bytes()));
  const auto of_user = std::count_if(uploads_.begin(), uploads_.end(), [&](const auto& entry) { return entry.second.user == user; });
  if (of_user >= kUploadsOfUserMax) return Exhausted("too many uploads at once; try again in a while");
  Upload& upload = uploads_[put.sha256()];
  upload.path = store_.NewTemporaryPath(".upload");
  upload.user = user;
  upload.bytes = put.bytes();
  upload.digest = std::make_unique<Sha256>();
  return &upload;
}

Result<v1::Envelope> ArtefactServer::OnPut(const std::string& user, const v1::PutChunk& put, std::string_view data) {
  v1::Envelope answer;
  v1::PutReply* reply = answer.mutable_put_reply();
  reply->set_sha256(put.sha256());
  const auto known = uploads_.find(put.sha256());
  if (known == uploads_.end() && IsStored(put)) {
    store_.Touch(put.sha256());
    reply->set_next_offset(put.bytes());
    reply->set_is_stored(true);
    return answer;
  }
  // Nothing is kept for a mere question.
  const bool is_question = data.empty() && put.bytes() > 0;
  if (known == uploads_.end() && is_question) {
    TREM_RETURN_IF_ERROR(CheckRoom(put.bytes()));
    return answer;
  }
  TREM_ASSIGN_OR_RETURN(Upload* const upload, UploadOf(user, put));
  if (upload->bytes != put.bytes()) {
    return InvalidInput("artefact " + put.sha256() + " was announced with " + std::to_string(upload->bytes) + " bytes, and now with " +
                        std::to_string(put.bytes()));
  }
  upload->used_at_ms = NowMs();
  Status status = put.offset() == upload->next_offset ? Append(put, data, upload) : Status();
  reply->set_next_offset(upload->next_offset);
  const bool is_complete = upload->next_offset == upload->bytes;
  if (status.ok() && is_complete) {
    status = Finish(put.sha256(), upload);
    reply->set_is_stored(status.ok());
  }
  if (!status.ok() || is_complete) {
    std::error_code ignored;
    fs::remove(upload->path, ignored);
    uploads_.erase(put.sha256());
  }
  if (!status.ok()) return status;
  return answer;
}

Status ArtefactServer::Finish(const std::string& sha256, Upload* upload) {
  if (const std::string found = upload->digest->FinishHex(); found != sha256) {
    return Corrupt("an upload has digest " + found + "; announced was " + sha256);
  }
  if (upload->bytes == 0) TREM_RETURN_IF_ERROR(WriteFileAtomically(upload->path, ""));
  TREM_RETURN_IF_ERROR(store_.PutHashed("upload", sha256, upload->path).status());
  store_bytes_ += upload->bytes;
  return {};
}

Status ArtefactServer::Append(const v1::PutChunk& put, std::string_view data, Upload* upload) {
  if (data.empty() && put.bytes() > 0) return {};  // A question.
  if (Xxh3(data) != put.data_xxh3()) return {};    // Damaged on its way: the reply asks for it again.
  TREM_ASSIGN_OR_RETURN(const OpenFile file, OpenFile::Open(upload->path, O_WRONLY | O_CREAT | O_NOFOLLOW));
  TREM_RETURN_IF_ERROR(file.WriteAt(put.offset(), data));
  upload->digest->Update(data);
  upload->next_offset += data.size();
  bytes_received_ += data.size();
  return {};
}

void ArtefactServer::ForgetOldUploads(std::int64_t now_ms) {
  std::erase_if(uploads_, [&](const auto& entry) {
    if (now_ms - entry.second.used_at_ms <= kUploadIdleMsMax) return false;
    std::error_code ignored;
    fs::remove(entry.second.path, ignored);
    return true;
  });
}

}  // namespace trem
