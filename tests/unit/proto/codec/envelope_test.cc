// Goal: what EncodeEnvelope writes, DecodeEnvelope reads; anything else is refused with a reason before it can do harm.
// Method: one valid message of every kind, then single faults put into its header, its body or its values.
#include "proto/codec/envelope.h"

#include <gmock/gmock.h>
#include <google/protobuf/util/message_differencer.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <vector>

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

const std::string kKey(64, 'a');

v1::Envelope SomeDone() {
  v1::Envelope envelope;
  v1::Done* done = envelope.mutable_done();
  done->mutable_attempt()->set_task_key(kKey);
  done->mutable_attempt()->set_attempt(3);
  v1::ArtefactRef* ref = done->mutable_result()->add_outputs();
  ref->set_name("window.pb");
  ref->set_sha256(std::string(64, '0'));
  return envelope;
}

v1::Envelope SomeHello() {
  v1::Envelope envelope;
  envelope.mutable_hello()->set_worker_id("host-1-22");
  envelope.mutable_hello()->add_running()->set_task_key(kKey);
  return envelope;
}

v1::Envelope SomeDispatch() {
  v1::Envelope envelope;
  envelope.mutable_dispatch()->set_lease_ms(1000);
  envelope.mutable_dispatch()->mutable_task()->set_key(kKey);
  envelope.mutable_dispatch()->mutable_task()->set_kind(v1::ENHANCE);
  return envelope;
}

v1::Envelope SomeProgress() {
  v1::Envelope envelope;
  envelope.mutable_progress()->mutable_attempt()->set_task_key(kKey);
  return envelope;
}

v1::Envelope SomeSubmit() {
  v1::Envelope envelope;
  envelope.mutable_submit_job()->set_job_id("job-1");
  envelope.mutable_submit_job()->mutable_sortie();
  return envelope;
}

v1::Envelope SomeTaskLog() {
  v1::Envelope envelope;
  envelope.mutable_task_log()->mutable_attempt()->set_task_key(std::string(64, 'a'));
  envelope.mutable_task_log()->add_lines("a line");
  return envelope;
}

v1::Envelope SomeShare() {
  v1::Envelope envelope;
  envelope.mutable_share()->mutable_attempt()->set_task_key(kKey);
  envelope.mutable_share()->mutable_attempt()->set_attempt(1);
  envelope.mutable_share()->set_processors(2);
  return envelope;
}

v1::Envelope SomeGetLog() {
  v1::Envelope envelope;
  envelope.mutable_get_log()->set_job_id("job");
  return envelope;
}

v1::Envelope SomeBackup() {
  v1::Envelope envelope;
  envelope.mutable_backup()->set_backup_id("nightly");
  return envelope;
}

v1::Envelope SomeReport() {
  v1::Envelope envelope;
  envelope.mutable_service_report()->add_refused_workers()->set_worker_id("w-1");
  return envelope;
}

v1::Envelope SomeArtefacts() {
  v1::Envelope envelope;
  envelope.mutable_artefact_list()->set_digests(std::string(64, 'x'));
  return envelope;
}

v1::Envelope SomeJobStatus() {
  v1::Envelope envelope;
  envelope.mutable_job_status()->set_job_id("job-1");
  envelope.mutable_job_status()->set_eta_s(-1.0);
  return envelope;
}

std::string DecodeError(const EnvelopeFrames& frames, const EnvelopeLimits& limits = {}) {
  const auto decoded = DecodeEnvelope(frames.header, frames.body, limits);
  return decoded.ok() ? "decoded: " + decoded->ShortDebugString() : decoded.status().ToString();
}

TEST(Envelope, DecodesWhatItEncoded) {
  v1::Envelope heartbeat;
  heartbeat.mutable_heartbeat();
  for (const v1::Envelope& envelope :
       {SomeDone(), SomeHello(), SomeDispatch(), SomeProgress(), SomeShare(), SomeSubmit(), SomeJobStatus(), heartbeat}) {
    const EnvelopeFrames frames = EncodeEnvelope(envelope);
    EXPECT_EQ(frames.header, std::string("TREM\x02\0\0\0", 8));
    const auto decoded = DecodeEnvelope(frames.header, frames.body);
    ASSERT_TRUE(decoded.ok()) << decoded.status().message();
    EXPECT_TRUE(google::protobuf::util::MessageDifferencer::Equals(envelope, *decoded));
  }
}

// The third frame belongs to chunks, to all of them, and never exceeds what was announced.
TEST(Envelope, KnowsWhichBytesMayTravelBesideIt) {
  v1::Envelope chunk, put, heartbeat;
  chunk.mutable_chunk()->set_sha256(std::string(64, 'a'));
  put.mutable_put_chunk()->set_sha256(std::string(64, 'a'));
  put.mutable_put_chunk()->set_bytes(1000);
  put.mutable_put_chunk()->set_offset(400);
  heartbeat.mutable_heartbeat();
  constexpr std::size_t kMost = std::size_t{4} << 20;
  EXPECT_TRUE(ValidatePayload(heartbeat, std::nullopt).ok());
  EXPECT_THAT(ValidatePayload(heartbeat, 0).message(), HasSubstr("a frame too many"));
  EXPECT_TRUE(ValidatePayload(chunk, kMost).ok());
  EXPECT_THAT(ValidatePayload(chunk, kMost + 1).message(), HasSubstr("at most 4194304"));
  EXPECT_THAT(ValidatePayload(chunk, std::nullopt).message(), HasSubstr("without the frame of its bytes"));
  EXPECT_TRUE(ValidatePayload(put, 0).ok());
  EXPECT_TRUE(ValidatePayload(put, 600).ok());
  EXPECT_THAT(ValidatePayload(put, 601).message(), HasSubstr("within the artefact's 1000 bytes"));
  put.mutable_put_chunk()->set_offset(1001);
  EXPECT_FALSE(ValidateEnvelope(put).ok());
}

TEST(Envelope, RefusesAnotherProtocolVersionInWords) {
  EnvelopeFrames frames = EncodeEnvelope(SomeDone());
  frames.header[4] = 2;
  frames.header[5] = 1;
  EXPECT_EQ(DecodeError(frames),
            "invalid input: the peer speaks protocol version 258, this program version 2; install the same release of trem on both sides");
}

TEST(Envelope, ReadsTheHelloOfAnotherProtocolAndNothingElse) {
  EnvelopeFrames frames = EncodeEnvelope(SomeHello());
  EXPECT_FALSE(ReadHelloOfOtherProtocol(frames.header, frames.body).has_value()) << "it is of this protocol";
  frames.header[4] = 1;
  const auto hello = ReadHelloOfOtherProtocol(frames.header, frames.body);
  ASSERT_TRUE(hello.has_value());
  EXPECT_EQ(hello->worker_id(), "host-1-22");
  EXPECT_EQ(hello->protocol_version(), 1U);
  EXPECT_FALSE(ReadHelloOfOtherProtocol("MERT" + frames.header.substr(4), frames.body).has_value());
  EXPECT_FALSE(ReadHelloOfOtherProtocol(frames.header.substr(0, 7), frames.body).has_value());
  EXPECT_FALSE(ReadHelloOfOtherProtocol(frames.header, frames.body.substr(0, frames.body.size() - 1)).has_value());
  EXPECT_FALSE(ReadHelloOfOtherProtocol(frames.header, EncodeEnvelope(SomeDone()).body).has_value());
  EnvelopeLimits limits;
  limits.body_bytes_max = frames.body.size() - 1;
  EXPECT_FALSE(ReadHelloOfOtherProtocol(frames.header, frames.body, limits).has_value());
  v1::Envelope bad = SomeHello();
  bad.mutable_hello()->set_worker_id("Of no such form");
  EXPECT_FALSE(ReadHelloOfOtherProtocol(frames.header, bad.SerializeAsString()).has_value());
}

TEST(Envelope, RefusesHeadersThatAreNotItsOwn) {
  const std::string body = EncodeEnvelope(SomeDone()).body;
  for (const std::string& header :
       {std::string(), std::string("TREM"), std::string("TREX\x02\0\0\0", 8), std::string("TREM\x02\0\0\0\0", 9)}) {
    EXPECT_THAT(DecodeError({header, body}), HasSubstr("header is not trem's"));
  }
  EXPECT_THAT(DecodeError({std::string("TREM\x02\0\x04\0", 8), body}), HasSubstr("unknown flags 0x4"));
}

TEST(Envelope, RefusesSizeAndDepthBeforeParsing) {
  const EnvelopeFrames frames = EncodeEnvelope(SomeDone());
  EnvelopeLimits small;
  small.body_bytes_max = frames.body.size() - 1;
  EXPECT_THAT(DecodeError(frames, small), HasSubstr("at most"));
  small.body_bytes_max = frames.body.size();
  EXPECT_THAT(DecodeError(frames, small), StartsWith("decoded"));
  EnvelopeLimits shallow;
  shallow.depth_max = 2;  // Envelope > Done > TaskResult > ArtefactRef has three levels below the top.
  EXPECT_THAT(DecodeError(frames, shallow), HasSubstr("nested deeper than 2 levels"));
  shallow.depth_max = 3;
  EXPECT_THAT(DecodeError(frames, shallow), StartsWith("decoded"));
}

TEST(Envelope, RefusesTruncatedAndUnknownBodies) {
  EnvelopeFrames frames = EncodeEnvelope(SomeDone());
  frames.body.pop_back();
  EXPECT_THAT(DecodeError(frames), HasSubstr("not a trem.v1.Envelope"));
  frames.body.clear();
  EXPECT_THAT(DecodeError(frames), HasSubstr("without a body that this version knows"));
  frames.body = "\xff\xff\xff\xff garbage";
  EXPECT_THAT(DecodeError(frames), HasSubstr("corrupt"));
}

// A message a millisecond of these must not be a line a millisecond in the coordinator's log.
TEST(Envelope, RefusesTextsThatAreNotUtf8WithoutAWordOnStderr) {
  const EnvelopeFrames frames = EncodeEnvelope(SomeGetLog());
  std::string body = frames.body;
  body[body.find("job")] = '\xff';
  ::testing::internal::CaptureStderr();
  EXPECT_THAT(DecodeError({frames.header, body}), HasSubstr("not a trem.v1.Envelope"));
  EXPECT_EQ(::testing::internal::GetCapturedStderr(), "");
}

TEST(Envelope, RefusesValuesOutOfRangeAndNamesThem) {
  struct Case {
    v1::Envelope envelope;
    std::function<void(v1::Envelope*)> spoil;
    const char* error;
  };
  const double nan = std::nan("");
  const std::vector<Case> cases = {
      {SomeDone(), [](auto* e) { e->mutable_done()->mutable_attempt()->set_task_key("A"); }, "done: task_key is 'A'"},
      {SomeDone(), [](auto* e) { e->mutable_done()->mutable_attempt()->set_task_key("../" + std::string(61, 'a')); }, "done: task_key is"},
      {SomeDone(), [](auto* e) { e->mutable_done()->mutable_result()->mutable_outputs(0)->set_sha256(std::string(64, 'G')); },
       "done: artefact digest is"},
      {SomeDone(), [](auto* e) { e->mutable_done()->set_status_code(3); }, "done: done is a failure with a result"},
      {SomeDone(), [](auto* e) { e->mutable_done()->clear_result(); }, "done: done is a success without a result"},
      {SomeDone(), [](auto* e) { e->mutable_done()->set_status_code(99); }, "done: status_code is 99; expected 0 to 7"},
      {SomeDone(), [=](auto* e) { e->mutable_done()->mutable_result()->mutable_ingest()->set_median_motion_px(nan); },
       "done: median_motion_px is nan"},
      {SomeDone(), [](auto* e) { e->mutable_done()->set_message(std::string(70000, 'x')); }, "done: message is 70000 bytes long"},
      {SomeHello(), [](auto* e) { e->mutable_hello()->set_worker_id("Host"); }, "hello: worker_id is 'Host'"},
      {SomeHello(), [](auto* e) { e->mutable_hello()->set_worker_id(std::string(129, 'a')); }, "hello: worker_id is"},
      {SomeHello(), [](auto* e) { e->mutable_hello()->mutable_running(0)->clear_task_key(); }, "hello: task_key is ''"},
      {SomeDispatch(), [](auto* e) { e->mutable_dispatch()->set_lease_ms(0); }, "dispatch: lease_ms is 0"},
      {SomeDispatch(), [](auto* e) { e->mutable_dispatch()->mutable_task()->set_kind(v1::TASK_KIND_UNSPECIFIED); },
       "dispatch: task kind is 0"},
      {SomeDispatch(), [](auto* e) { e->mutable_dispatch()->mutable_task()->set_kind(static_cast<v1::TaskKind>(42)); },
       "dispatch: task kind is 42"},
      {SomeDispatch(), [](auto* e) { e->mutable_dispatch()->mutable_task()->mutable_enhance()->mutable_roi_in_sensor()->set_x0(5); },
       "dispatch: roi is [5, 0) x [0, 0)"},
      {SomeShare(), [](auto* e) { e->mutable_share()->set_processors(0); }, "share: processors is 0; expected 1 to 4096"},
      {SomeShare(), [](auto* e) { e->mutable_share()->set_processors(5000); }, "share: processors is 5000; expected 1 to 4096"},
      {SomeProgress(), [=](auto* e) { e->mutable_progress()->set_fraction(nan); }, "progress: fraction is nan; expected 0 to 1"},
      {SomeProgress(), [](auto* e) { e->mutable_progress()->set_fraction(1.5); }, "progress: fraction is 1.5; expected 0 to 1"},
      {SomeSubmit(), [](auto* e) { e->mutable_submit_job()->set_job_id("a/b"); }, "submit_job: job_id is 'a/b'"},
      {SomeSubmit(), [](auto* e) { e->mutable_submit_job()->set_job_id(std::string(65, 'a')); }, "submit_job: job_id is"},
      {SomeSubmit(), [](auto* e) { e->mutable_submit_job()->clear_sortie(); }, "submit_job: sortie is missing"},
      {SomeTaskLog(), [](auto* e) { e->mutable_task_log()->set_lines(0, std::string(5000, 'x')); }, "task_log: line is 5000 bytes long"},
      {SomeTaskLog(),
       [](auto* e) {
         for (int i = 0; i < 300; ++i) e->mutable_task_log()->add_lines("x");
       },
       "task_log: lines is 301 lines"},
      {SomeGetLog(), [](auto* e) { e->mutable_get_log()->set_job_id("../x"); }, "get_log: job_id is '../x'"},
      {SomeBackup(), [](auto* e) { e->mutable_backup()->set_backup_id("../x"); }, "backup: backup_id is malformed"},
      {SomeReport(), [](auto* e) { e->mutable_service_report()->mutable_refused_workers(0)->set_worker_id("../x"); },
       "service_report: worker_id is '../x'"},
      {SomeReport(), [](auto* e) { e->mutable_service_report()->set_version(std::string(300, 'x')); },
       "service_report: version is 300 bytes"},
      {SomeReport(),
       [](auto* e) {
         for (int i = 0; i < 64; ++i) e->mutable_service_report()->add_refused_workers()->set_worker_id("w");
       },
       "service_report: refused_workers is 65 entries"},
      {SomeArtefacts(), [](auto* e) { e->mutable_artefact_list()->set_digests("abc"); }, "artefact_list: digests is 3 bytes long"},
      {SomeJobStatus(), [](auto* e) { e->mutable_job_status()->set_eta_high_s(std::numeric_limits<double>::infinity()); },
       "job_status: eta_high_s is inf"},
      {SomeJobStatus(), [](auto* e) { e->mutable_job_status()->set_eta_s(std::numeric_limits<double>::infinity()); },
       "job_status: eta_s is inf"},
  };
  for (const Case& test_case : cases) {
    v1::Envelope envelope = test_case.envelope;
    EXPECT_TRUE(ValidateEnvelope(envelope).ok());
    test_case.spoil(&envelope);
    std::string header = EncodeEnvelope(test_case.envelope).header;
    EXPECT_THAT(DecodeError({header, envelope.SerializeAsString()}), StartsWith(std::string("corrupt: ") + test_case.error));
  }
}

TEST(EnvelopeDeathTest, TreatsAnInvalidMessageOfOurOwnAsABug) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_DEATH((void)EncodeEnvelope(v1::Envelope()), "check failed");
}

TEST(Identifiers, AcceptLowerCaseLettersDigitsAndHyphensOnly) {
  EXPECT_TRUE(IsJobId("leg-3"));
  EXPECT_TRUE(IsJobId(std::string(64, '9')));
  EXPECT_TRUE(IsWorkerId(std::string(128, 'z')));
  for (const char* bad : {"", "Leg", "a b", "a_b", "a.b", "\xc3\xa4", "../x"}) EXPECT_FALSE(IsJobId(bad)) << bad;
}

}  // namespace
}  // namespace trem
