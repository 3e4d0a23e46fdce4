#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/channel/dealer_channel.h"

namespace trem {

inline constexpr std::uint64_t kChunkBytes = std::uint64_t{1} << 20;
inline constexpr std::uint64_t kCreditChunks = 8;

// The far end of a coordinator's data lane: artefacts travel in chunks, each with its own checksum, kCreditChunks of them on their way at a
// time. What gets lost is asked for again; after a break the transfer goes on where it stopped. What was fetched is digested as it comes.
class ArtefactChannel final : public ArtefactBacking {
 public:
  // `coordinator`: endpoint of the control lane, which is asked for the data lane at every (re)connection.
  ArtefactChannel(std::string coordinator, const ChannelOptions& options);
  ~ArtefactChannel() override;

  // Called between chunks; false ends the transfer with kCancelled. Empty: nobody is asked.
  void set_on_chunk(std::function<bool()> on_chunk) { on_chunk_ = std::move(on_chunk); }

  // Errors: kNotFound, kCorrupt, kExhausted (the store is full) as the coordinator says; kUnavailable when it is silent for half a minute.
  Result<std::string> Fetch(const ArtefactRef& ref, const std::filesystem::path& path) override;
  Status Deliver(const ArtefactRef& ref, const std::filesystem::path& path) override;

 private:
  Status Connect();
  // The next answer about `sha256`; nothing when it was silent and the connection was made anew. kUnavailable after `silences` of those.
  Result<std::optional<v1::Envelope>> Receive(const std::string& sha256, int* silences, Payload* payload);
  Result<v1::Envelope> AskControl(DealerChannel* channel, const v1::Envelope& question) const;
  Status Send(const v1::Envelope& envelope, Payload payload);
  // Asks for chunks from `*requested` on as far as the credit goes.
  void Ask(const ArtefactRef& ref, std::uint64_t received, std::uint64_t* requested);

  std::string coordinator_;
  ChannelOptions options_;
  std::function<bool()> on_chunk_;
  std::unique_ptr<DealerChannel> channel_;  // To the data lane; null: not connected.
};

}  // namespace trem
