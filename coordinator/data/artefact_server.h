#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>
#include <utility>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/digest.h"
#include "mosaic/base/status.h"
#include "proto/channel/router_channel.h"

namespace trem {

struct ArtefactServerOptions {
  // Uploads that would make the store larger than this are refused with kExhausted; what is there stays. 0: no limit.
  std::uint64_t store_bytes_max = 0;
};

// A coordinator's data lane: hands out and takes in artefacts in verified chunks, on a thread of its own. Whoever may connect may read
// every artefact whose digest he knows.
class ArtefactServer {
 public:
  static Result<std::unique_ptr<ArtefactServer>> Start(const std::string& endpoint, const ChannelOptions& channel_options,
                                                       ArtefactStore store, const ArtefactServerOptions& options);
  ~ArtefactServer();
  ArtefactServer(const ArtefactServer&) = delete;
  ArtefactServer& operator=(const ArtefactServer&) = delete;

  const std::string& endpoint() const { return channel_->endpoint(); }
  // What a count of the store has found. From any thread.
  void set_store_bytes(std::uint64_t bytes) { store_bytes_ = bytes; }
  // Bytes of artefacts handed out and taken in so far.
  std::uint64_t bytes_sent() const { return bytes_sent_; }
  std::uint64_t bytes_received() const { return bytes_received_; }
  // Of its socket, as they were a moment ago. From any thread.
  ChannelCounters counters() const;

 private:
  // What has arrived of an artefact, from whomever: who was cut off goes on over another connection, and two who computed the same task
  // share the work.
  struct Upload {
    std::filesystem::path path;
    std::string user;  // Who began it.
    std::uint64_t bytes = 0;
    std::uint64_t next_offset = 0;
    std::unique_ptr<Sha256> digest;  // Of what has arrived: the end of a long one does not keep the others waiting.
    std::int64_t used_at_ms = 0;
  };

  ArtefactServer(std::unique_ptr<RouterChannel> channel, ArtefactStore store, const ArtefactServerOptions& options);
  void Serve();
  Result<v1::Envelope> Answer(const RouterChannel::Incoming& incoming, Payload* payload);
  Result<v1::Envelope> OnGet(const v1::GetChunk& get, Payload* payload);
  Result<v1::Envelope> OnPut(const std::string& user, const v1::PutChunk& put, std::string_view data);
  bool IsStored(const v1::PutChunk& put) const;
  Result<Upload*> UploadOf(const std::string& user, const v1::PutChunk& put);
  Status Append(const v1::PutChunk& put, std::string_view data, Upload* upload);
  Status Finish(const std::string& sha256, Upload* upload);
  Status CheckRoom(std::uint64_t bytes) const;
  void ForgetOldUploads(std::int64_t now_ms);

  std::unique_ptr<RouterChannel> channel_;
  ArtefactStore store_;
  ArtefactServerOptions options_;
  std::map<std::string, Upload> uploads_;      // By digest.
  std::atomic<std::uint64_t> store_bytes_{0};  // As known here: counted at the start and by sweeps, and what came in since.
  std::atomic<bool> stop_{false};
  mutable std::mutex counters_mutex_;
  ChannelCounters counters_;
  std::atomic<std::uint64_t> bytes_sent_{0};
  std::atomic<std::uint64_t> bytes_received_{0};
  std::thread thread_;
};

}  // namespace trem
