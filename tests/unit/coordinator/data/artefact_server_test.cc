// Goal: artefacts get through the data lane whole or not at all, in both directions, and a transfer that broke off goes on. Method: a real
// server and real channels over ipc; a stand-in for the control lane only says where the server is.
#include "coordinator/data/artefact_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <thread>
#include <zmq.hpp>

#include "mosaic/base/digest.h"
#include "mosaic/base/file.h"
#include "proto/channel/artefact_channel.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// `bytes` bytes without a period that a lost or repeated chunk could hide in.
std::string Noise(std::size_t bytes) {
  std::string text(bytes, '\0');
  std::uint32_t state = 1;
  for (char& c : text) c = static_cast<char>((state = state * 1664525U + 1013904223U) >> 24);
  return text;
}

class ArtefactServerTest : public ::testing::Test {
 protected:
  ArtefactServerTest() {
    Start();
    control_ = std::move(RouterChannel::Bind(Endpoint("control"))).value();
    thread_ = std::thread([this] {
      while (!stop_) {
        const auto incoming = control_->Poll(std::chrono::milliseconds(50));
        if (!incoming || !incoming->envelope.ok()) continue;
        v1::Envelope answer;
        answer.mutable_data_lane()->set_endpoint(Endpoint("data"));
        control_->Send(incoming->peer, answer);
      }
    });
  }
  ~ArtefactServerTest() override {
    stop_ = true;
    thread_.join();
  }
  std::string Endpoint(const std::string& name) const { return "ipc://" + (folder_ / name).string(); }
  void Start(const ArtefactServerOptions& options = {}) {
    server_.reset();
    server_ = std::move(ArtefactServer::Start(Endpoint("data"), {}, store_, options)).value();
  }
  // A cache with nothing in it yet.
  ArtefactStore NewCache(const std::string& name) const {
    return ArtefactStore::OpenCache(folder_ / name, std::make_shared<ArtefactChannel>(Endpoint("control"), ChannelOptions{})).value();
  }
  fs::path ObjectOf(const ArtefactRef& ref) const { return store_.Locate(ref).value(); }

  testing::TempDir folder_;
  ArtefactStore store_ = ArtefactStore::Open(folder_ / "store").value();
  std::unique_ptr<ArtefactServer> server_;
  std::unique_ptr<RouterChannel> control_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

TEST_F(ArtefactServerTest, CarriesArtefactsOfAnySizeBothWays) {
  const ArtefactStore near = NewCache("near");
  const ArtefactStore far = NewCache("far");
  for (const std::size_t bytes :
       {std::size_t{0}, std::size_t{1}, std::size_t{1} << 20, (std::size_t{1} << 20) + 1, std::size_t{20'000'000}}) {
    const std::string content = Noise(bytes);
    const ArtefactRef ref = near.PutBytes("a", content).value();
    EXPECT_TRUE(store_.Verify(ref).ok()) << bytes;
    const auto read = far.ReadVerified(ref, 1 << 30);
    ASSERT_TRUE(read.ok()) << bytes << " " << read.status().message();
    EXPECT_TRUE(*read == content) << bytes;
  }
}

TEST_F(ArtefactServerTest, SendsNothingTwice) {
  const std::string content = Noise(5'000'000);
  ASSERT_TRUE(NewCache("one").PutBytes("a", content).ok());
  EXPECT_EQ(server_->bytes_received(), content.size());
  const ArtefactStore two = NewCache("two");
  const ArtefactRef ref = two.PutBytes("a", content).value();
  EXPECT_EQ(server_->bytes_received(), content.size());
  ASSERT_TRUE(two.Locate(ref).ok());
  EXPECT_EQ(server_->bytes_sent(), 0U);
}

TEST_F(ArtefactServerTest, GoesOnWhereAFetchBrokeOff) {
  const std::string content = Noise(8'000'000);
  const ArtefactRef ref = store_.PutBytes("a", content).value();
  const ArtefactStore cache = NewCache("cache");
  ASSERT_TRUE(WriteFileAtomically(folder_ / "cache/tmp" / (ref.sha256 + ".part"), content.substr(0, 7'000'000)).ok());
  ASSERT_TRUE(cache.ReadVerified(ref, 1 << 30).ok());
  EXPECT_EQ(server_->bytes_sent(), 1'000'000U);
}

TEST_F(ArtefactServerTest, APartThatIsNotTheArtefactsBeginningIsFetchedAnew) {
  const ArtefactRef ref = store_.PutBytes("a", Noise(3'000'000)).value();
  const ArtefactStore cache = NewCache("cache");
  ASSERT_TRUE(WriteFileAtomically(folder_ / "cache/tmp" / (ref.sha256 + ".part"), std::string(2'000'000, 'x')).ok());
  EXPECT_TRUE(cache.Verify(ref).ok());
}

TEST_F(ArtefactServerTest, ACacheMendsWhatWasDamagedInIt) {
  const std::string content = Noise(300'000);
  const ArtefactRef ref = store_.PutBytes("a", content).value();
  const ArtefactStore cache = NewCache("cache");
  const fs::path here = cache.Locate(ref).value();
  for (const bool whole : {true, false}) {
    trem::testing::WriteFileContents(here, std::string(content.size(), 'x'));
    EXPECT_TRUE(whole ? cache.ReadVerified(ref, 1 << 30).value() == content : cache.Verify(ref).ok());
    EXPECT_TRUE(cache.Verify(ref).ok());
  }
}

TEST_F(ArtefactServerTest, WhatWasDamagedInTheStoreIsTakenInAgain) {
  const std::string content = Noise(300'000);
  const ArtefactRef ref = store_.PutBytes("a", content).value();
  trem::testing::WriteFileContents(ObjectOf(ref), std::string(content.size(), 'x'));
  ASSERT_TRUE(NewCache("maker").PutBytes("a", content).ok());
  EXPECT_TRUE(store_.Verify(ref).ok());
}

// Eight requests are on their way when the first is refused; the other seven refusals must not reach the next artefact.
TEST_F(ArtefactServerTest, ARefusalIsTakenForNoOtherArtefact) {
  const ArtefactRef there = store_.PutBytes("a", Noise(3'000'000)).value();
  const ArtefactStore cache = NewCache("cache");
  for (int i = 0; i < 5; ++i) {
    const ArtefactRef missing{"b", Sha256Hex("never stored " + std::to_string(i)), 50'000'000};
    EXPECT_EQ(cache.Locate(missing).status().code(), StatusCode::kNotFound);
  }
  EXPECT_TRUE(cache.Verify(there).ok());
  trem::testing::WriteFileContents(ObjectOf(there), "short");
  ArtefactRef larger = there;
  larger.sha256 = Sha256Hex("never stored");
  EXPECT_EQ(cache.Locate(larger).status().code(), StatusCode::kNotFound);
}

TEST_F(ArtefactServerTest, AnUploadThatBrokeOffGoesOnOverAnotherConnection) {
  const std::string content = Noise(10'000'000);
  int chunks = 0;
  const auto broken = std::make_shared<ArtefactChannel>(Endpoint("control"), ChannelOptions{});
  broken->set_on_chunk([&] { return ++chunks < 6; });
  EXPECT_EQ(ArtefactStore::OpenCache(folder_ / "one", broken)->PutBytes("a", content).status().code(), StatusCode::kCancelled);
  const ArtefactRef ref = NewCache("two").PutBytes("a", content).value();
  EXPECT_TRUE(store_.Verify(ref).ok());
  EXPECT_EQ(server_->bytes_received(), content.size());
}

TEST_F(ArtefactServerTest, TwoWhoBringTheSameArtefactShareTheWork) {
  const std::string content = Noise(30'000'000);
  std::vector<Result<ArtefactRef>> refs(4, Failed("not yet"));
  std::vector<std::thread> threads;
  for (std::size_t i = 0; i < refs.size(); ++i) {
    threads.emplace_back([&, i] { refs[i] = NewCache("cache" + std::to_string(i)).PutBytes("a", content); });
  }
  for (std::thread& thread : threads) thread.join();
  for (const Result<ArtefactRef>& ref : refs) EXPECT_TRUE(ref.ok()) << ref.status().message();
  EXPECT_TRUE(store_.Verify(*refs[0]).ok());
  EXPECT_EQ(server_->bytes_received(), content.size());
}

TEST_F(ArtefactServerTest, UploadsThatAreUnderWayCountTowardsTheLimit) {
  Start({20'000'000});
  int chunks = 0;
  const auto broken = std::make_shared<ArtefactChannel>(Endpoint("control"), ChannelOptions{});
  broken->set_on_chunk([&] { return ++chunks < 6; });
  EXPECT_FALSE(ArtefactStore::OpenCache(folder_ / "one", broken)->PutBytes("a", Noise(15'000'000)).ok());
  EXPECT_EQ(NewCache("two").PutBytes("b", Noise(6'000'000)).status().code(), StatusCode::kExhausted);
}

// Whoever asks for far more than his credit and takes none of it: what waits for him at the server is bounded, and others are served.
TEST_F(ArtefactServerTest, WhoDoesNotTakeWhatHeAskedForFillsNoMemory) {
  constexpr int kAsked = 400;
  constexpr std::uint32_t kBytes = std::uint32_t{4} << 20;
  const ArtefactRef ref = store_.PutBytes("a", Noise(kBytes)).value();
  zmq::context_t context;
  zmq::socket_t greedy(context, zmq::socket_type::dealer);
  greedy.set(zmq::sockopt::linger, 0);
  greedy.set(zmq::sockopt::rcvhwm, 1);
  greedy.connect(Endpoint("data"));
  v1::Envelope question;
  question.mutable_get_chunk()->set_sha256(ref.sha256);
  question.mutable_get_chunk()->set_bytes_max(kBytes);
  const EnvelopeFrames frames = EncodeEnvelope(question);
  for (int i = 0; i < kAsked; ++i) {
    (void)greedy.send(zmq::buffer(frames.header), zmq::send_flags::sndmore);
    (void)greedy.send(zmq::buffer(frames.body), zmq::send_flags::none);
  }
  while (server_->bytes_sent() < std::uint64_t{kAsked} * kBytes) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_TRUE(NewCache("cache").Verify(ref).ok());
  greedy.set(zmq::sockopt::rcvtimeo, 500);
  int taken = 0;
  for (zmq::message_t frame; greedy.recv(frame);) taken += frame.more() ? 0 : 1;
  EXPECT_GE(taken, 1);
  EXPECT_LE(taken, 8 * static_cast<int>(kCreditChunks)) << "the queue holds four credits; kernel and receiver hold some more";
}

TEST_F(ArtefactServerTest, ADamagedChunkOfAnUploadIsAskedForAgain) {
  const std::string content = Noise(1000);
  const std::unique_ptr<DealerChannel> channel = DealerChannel::Connect(Endpoint("data")).value();
  const auto put = [&](std::uint64_t checksum) {
    v1::Envelope envelope;
    envelope.mutable_put_chunk()->set_sha256(Sha256Hex(content));
    envelope.mutable_put_chunk()->set_bytes(content.size());
    envelope.mutable_put_chunk()->set_data_xxh3(checksum);
    Payload payload(content.size());
    std::copy(content.begin(), content.end(), payload.data());
    EXPECT_TRUE(channel->Send(envelope, std::chrono::seconds(10), std::move(payload)).ok());
    return channel->Receive(std::chrono::seconds(10)).value()->put_reply();
  };
  const v1::PutReply damaged = put(Xxh3(content) ^ 1);
  EXPECT_EQ(damaged.next_offset(), 0U);
  EXPECT_FALSE(damaged.is_stored());
  EXPECT_TRUE(put(Xxh3(content)).is_stored());
}

// A stand-in for the data lane that gives each chunk of an artefact of `content`, the first `damaged` of them with a bit changed; with
// `is_hidden` the checksum is that of the changed bytes, as if the damage had been done before.
class DamagingServer {
 public:
  DamagingServer(const std::string& endpoint, std::string content, int damaged, bool is_hidden)
      : content_(std::move(content)), channel_(RouterChannel::Bind(endpoint).value()), thread_([this, damaged, is_hidden] {
          for (int left = damaged; !stop_;) {
            const auto incoming = channel_->Poll(std::chrono::milliseconds(50));
            if (incoming && incoming->envelope.ok()) left -= Answer(*incoming, left > 0, is_hidden);
          }
        }) {}
  ~DamagingServer() {
    stop_ = true;
    thread_.join();
  }

 private:
  int Answer(const RouterChannel::Incoming& incoming, bool damage, bool is_hidden) {
    const v1::GetChunk& get = incoming.envelope->get_chunk();
    Payload payload(get.bytes_max());
    std::copy_n(content_.begin() + static_cast<std::ptrdiff_t>(get.offset()), payload.size(), payload.data());
    v1::Envelope answer;
    answer.mutable_chunk()->set_sha256(get.sha256());
    answer.mutable_chunk()->set_offset(get.offset());
    if (!is_hidden) answer.mutable_chunk()->set_data_xxh3(Xxh3(payload.bytes()));
    if (damage) payload.data()[payload.size() / 2] ^= 1;
    if (is_hidden) answer.mutable_chunk()->set_data_xxh3(Xxh3(payload.bytes()));
    channel_->Send(incoming.peer, answer, std::move(payload));
    return damage ? 1 : 0;
  }

  std::string content_;
  std::unique_ptr<RouterChannel> channel_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

TEST_F(ArtefactServerTest, AChunkThatWasDamagedOnItsWayIsFetchedAgain) {
  server_.reset();
  const std::string content = Noise(3'000'000);
  const ArtefactRef ref{"a", Sha256Hex(content), content.size()};
  const DamagingServer server(Endpoint("data"), content, 2, false);
  const auto read = NewCache("cache").ReadVerified(ref, 1 << 30);
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_TRUE(*read == content);
}

TEST_F(ArtefactServerTest, WhatKeepsArrivingDamagedIsRefused) {
  server_.reset();
  const std::string content = Noise(3'000'000);
  const ArtefactRef ref{"a", Sha256Hex(content), content.size()};
  for (const bool is_hidden : {false, true}) {
    const DamagingServer server(Endpoint("data"), content, 1'000'000, is_hidden);
    const ArtefactStore cache = NewCache(is_hidden ? "one" : "two");
    const Status status = cache.Locate(ref).status();
    EXPECT_EQ(status.code(), StatusCode::kCorrupt);
    EXPECT_THAT(status.message(), HasSubstr(is_hidden ? "arrived with digest" : "chunks arrive damaged"));
    std::uint64_t bytes = 0;
    EXPECT_FALSE(cache.Find(ref.sha256, &bytes).ok());
  }
}

TEST_F(ArtefactServerTest, SaysThatAnArtefactIsMissingOrDamaged) {
  const ArtefactStore cache = NewCache("cache");
  ArtefactRef ref = store_.PutBytes("a", Noise(100'000)).value();
  trem::testing::WriteFileContents(ObjectOf(ref), std::string(100'000, 'x'));
  EXPECT_EQ(cache.Locate(ref).status().code(), StatusCode::kCorrupt);
  ref.sha256 = Sha256Hex("never stored");
  EXPECT_EQ(cache.Locate(ref).status().code(), StatusCode::kNotFound);
}

TEST_F(ArtefactServerTest, AFullStoreTakesNothingMoreAndKeepsWhatItHas) {
  const ArtefactRef kept = store_.PutBytes("kept", Noise(600'000)).value();
  Start({1'000'000});
  const ArtefactStore cache = NewCache("cache");
  const auto refused = cache.PutBytes("large", Noise(500'000));
  EXPECT_EQ(refused.status().code(), StatusCode::kExhausted);
  EXPECT_THAT(refused.status().message(), HasSubstr("--store-bytes-max"));
  EXPECT_TRUE(cache.PutBytes("small", Noise(300'000)).ok());
  EXPECT_TRUE(cache.Locate(kept).ok());
}

TEST_F(ArtefactServerTest, ASecondServerTakesOver) {
  const ArtefactRef ref = store_.PutBytes("a", Noise(3'000'000)).value();
  const ArtefactStore cache = NewCache("cache");
  ASSERT_TRUE(cache.PutBytes("b", "b").ok());
  Start();
  EXPECT_TRUE(cache.Locate(ref).ok());
}

TEST_F(ArtefactServerTest, AStoppedTransferEnds) {
  const ArtefactRef ref = store_.PutBytes("a", Noise(3'000'000)).value();
  const auto channel = std::make_shared<ArtefactChannel>(Endpoint("control"), ChannelOptions{});
  channel->set_on_chunk([] { return false; });
  EXPECT_EQ(ArtefactStore::OpenCache(folder_ / "cache", channel)->Locate(ref).status().code(), StatusCode::kCancelled);
}

TEST_F(ArtefactServerTest, ACacheForgetsWhatWasUsedLeastRecently) {
  const ArtefactStore cache = NewCache("cache");
  std::vector<ArtefactRef> refs;
  for (int i = 0; i < 4; ++i) refs.push_back(cache.PutBytes("a", Noise(1000 + static_cast<std::size_t>(i))).value());
  const auto now = fs::file_time_type::clock::now();
  for (std::size_t i = 0; i < refs.size(); ++i) {
    fs::last_write_time(folder_ / "cache/objects" / refs[i].sha256.substr(0, 2) / refs[i].sha256,
                        now - std::chrono::hours(10 - static_cast<int>(i)));
  }
  ASSERT_TRUE(cache.Locate(refs[0]).ok());  // Now the youngest.
  ASSERT_TRUE(cache.Trim(2500, std::chrono::minutes(1)).ok());
  std::uint64_t bytes = 0;
  EXPECT_TRUE(cache.Find(refs[0].sha256, &bytes).ok());
  EXPECT_FALSE(cache.Find(refs[1].sha256, &bytes).ok());
  EXPECT_FALSE(cache.Find(refs[2].sha256, &bytes).ok());
  EXPECT_TRUE(cache.Find(refs[3].sha256, &bytes).ok());
  EXPECT_TRUE(cache.Locate(refs[1]).ok()) << "what was forgotten is fetched again";
}

TEST_F(ArtefactServerTest, ACacheSparesWhatSomebodyMayBeReading) {
  const ArtefactStore cache = NewCache("cache");
  const ArtefactRef ref = cache.PutBytes("a", Noise(1000)).value();
  ASSERT_TRUE(cache.Trim(0, std::chrono::minutes(1)).ok());
  std::uint64_t bytes = 0;
  EXPECT_TRUE(cache.Find(ref.sha256, &bytes).ok());
  ASSERT_TRUE(cache.Trim(0, std::chrono::seconds(-1)).ok());
  EXPECT_FALSE(cache.Find(ref.sha256, &bytes).ok());
}

TEST_F(ArtefactServerTest, ALinkIsNoArtefact) {
  const ArtefactRef ref = store_.PutBytes("a", "content").value();
  const fs::path object = ObjectOf(ref);
  fs::rename(object, folder_ / "elsewhere");
  fs::create_symlink(folder_ / "elsewhere", object);
  EXPECT_EQ(store_.Locate(ref).status().code(), StatusCode::kCorrupt);
}

}  // namespace
}  // namespace trem
