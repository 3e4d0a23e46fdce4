#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "mosaic/base/status.h"
#include "proto/channel/dealer_channel.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// Files of keys, see ChannelOptionsOf; empty: no keys.
struct KeyPaths {
  std::filesystem::path own;
  std::filesystem::path coordinator;
};

// Questions and answers with a coordinator, one at a time. Every question may be repeated without harm, so a lost one is asked again.
class Client {
 public:
  // Called at least every 100 ms while waiting; an error ends the wait with it.
  using Idle = std::function<Status()>;

  // `patience`: how long a question may stay unanswered while this process runs. `idle` may be empty: then an interrupt (see interrupt.h)
  // ends the wait.
  Client(std::string endpoint, std::chrono::milliseconds patience, Idle idle = {}, KeyPaths keys = {});
  ~Client();

  // The answer; an ErrorReply becomes its Status; kUnavailable names the endpoint.
  Result<v1::Envelope> Ask(const v1::Envelope& question);

  Result<v1::JobStatus> Submit(const std::string& job_id, const v1::Sortie& sortie, int priority = 0);
  // kNotFound when the coordinator does not know the job.
  Result<v1::JobStatus> GetJob(const std::string& job_id);
  // Sends Shutdown without waiting for the answer.
  void SendShutdown();
  // Sleeps, calling `idle` as often as when waiting.
  Status Pause(std::chrono::milliseconds duration);

 private:
  Result<v1::JobStatus> AskForJob(const v1::Envelope& question);
  Status Idled() const;

  std::string endpoint_;
  std::chrono::milliseconds patience_;
  Idle idle_;
  KeyPaths keys_;
  std::unique_ptr<DealerChannel> channel_;
};

}  // namespace trem
