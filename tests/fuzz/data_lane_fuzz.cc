// Goal: no messages on the data lane harm it: what is in no order, too long, damaged or lied about is refused, what it keeps has the digest
// that it was announced with, what it hands out has the checksum beside it, and the next question is answered. Method: an ArtefactServer on
// loopback; each input is a few messages of one connection: arbitrary frames, or chunks and questions whose fields, checksum, bytes and
// number of frames come from the input.
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>
#include <zmq.hpp>

#include "coordinator/data/artefact_server.h"
#include "mosaic/base/check.h"
#include "mosaic/base/digest.h"
#include "mosaic/base/file.h"
#include "proto/codec/envelope.h"
#include "tests/fuzz/scratch_folder.h"

namespace {

namespace fs = std::filesystem;

constexpr int kMessagesMax = 8;       // Fewer than the lane lets wait.
constexpr int kInputsAServer = 2000;  // Then a new folder begins: what was stored would fill the disk.
constexpr int kSilencesMax = 12;
constexpr std::size_t kChunkBytesTooMany = (std::size_t{4} << 20) + 1;

// Numbers and bytes off the input, zeros behind its end.
class Input {
 public:
  explicit Input(std::string_view bytes) : bytes_(bytes) {}
  bool is_empty() const { return bytes_.empty(); }
  std::uint64_t Number(std::size_t size) {
    std::uint64_t number = 0;
    for (const char byte : Bytes(size)) number = number << 8 | static_cast<unsigned char>(byte);
    return number;
  }
  std::string Bytes(std::size_t size) {
    std::string taken(bytes_.substr(0, size));
    bytes_.remove_prefix(taken.size());
    return taken;
  }

 private:
  std::string_view bytes_;
};

struct Lane {
  fs::path folder = trem::fuzz::MakeScratchFolder();
  trem::ArtefactStore store = std::move(trem::ArtefactStore::Open(folder)).value();
  std::unique_ptr<trem::ArtefactServer> server = std::move(trem::ArtefactServer::Start("tcp://127.0.0.1:*", {}, store, {})).value();
  zmq::context_t context;
  zmq::socket_t socket{context, zmq::socket_type::dealer};

  Lane() {
    socket.set(zmq::sockopt::linger, 0);
    socket.set(zmq::sockopt::rcvtimeo, 5'000);
    socket.connect(server->endpoint());
  }
  ~Lane() {
    server.reset();
    std::error_code ignored;
    fs::remove_all(folder, ignored);
  }
  void Send(const std::vector<std::string>& frames) {
    for (std::size_t i = 0; i < frames.size(); ++i)
      socket.send(zmq::buffer(frames[i]), i + 1 < frames.size() ? zmq::send_flags::sndmore : zmq::send_flags::none);
  }
};

std::string Header() {
  trem::v1::Envelope heartbeat;
  heartbeat.mutable_heartbeat();
  return trem::EncodeEnvelope(heartbeat).header;
}

void AddPayload(std::uint64_t flags, std::string data, std::vector<std::string>* frames) {
  if ((flags & 0x10) != 0) return;  // A chunk without its bytes.
  if ((flags & 0x60) == 0x60) data.resize(kChunkBytesTooMany);
  frames->push_back(std::move(data));
  if ((flags & 0x80) != 0) frames->push_back("one too many");
}

// A chunk of an artefact of the input's; each bit of `flags` makes it wrong in a way of its own.
std::vector<std::string> MakePut(Input* input, std::string* sha256) {
  const std::uint64_t flags = input->Number(1);
  const std::string whole = input->Bytes(input->Number(1));
  *sha256 = trem::Sha256Hex((flags & 1) != 0 ? whole + "!" : whole);
  const std::uint64_t offset = (flags & 2) != 0 ? input->Number(8) : std::min<std::uint64_t>(input->Number(1), whole.size());
  const std::string data = (flags & 4) != 0 ? input->Bytes(16) : whole.substr(std::min<std::uint64_t>(offset, whole.size()));
  trem::v1::Envelope envelope;
  trem::v1::PutChunk* put = envelope.mutable_put_chunk();
  put->set_sha256(*sha256);
  put->set_bytes((flags & 8) != 0 ? input->Number(8) : whole.size());
  put->set_offset(offset);
  put->set_data_xxh3((flags & 0x60) == 0x20 ? input->Number(8) : trem::Xxh3(data));
  std::vector<std::string> frames = {Header(), envelope.SerializeAsString()};
  AddPayload(flags, data, &frames);
  return frames;
}

std::vector<std::string> MakeGet(Input* input, const std::string& sha256) {
  const std::uint64_t flags = input->Number(1);
  trem::v1::Envelope envelope;
  trem::v1::GetChunk* get = envelope.mutable_get_chunk();
  get->set_sha256((flags & 1) != 0 ? input->Bytes(64) : sha256);
  get->set_offset((flags & 2) != 0 ? input->Number(8) : input->Number(1));
  get->set_bytes_max(static_cast<std::uint32_t>((flags & 4) != 0 ? input->Number(4) : 64));
  std::vector<std::string> frames = {Header(), envelope.SerializeAsString()};
  if ((flags & 8) != 0) frames.push_back(input->Bytes(8));
  return frames;
}

std::vector<std::string> MakeMessage(Input* input, std::string* sha256) {
  switch (input->Number(1) % 4) {
    case 0: {
      std::vector<std::string> frames(1 + input->Number(1) % 4);
      for (std::string& frame : frames) frame = input->Bytes(input->Number(1));
      return frames;
    }
    case 1:
      return {Header(), input->Bytes(input->Number(1)), input->Bytes(input->Number(1))};
    case 2:
      return MakeGet(input, *sha256);
    default:
      return MakePut(input, sha256);
  }
}

// Asks, and takes what the lane answers up to the answer to that. Asks again after a silence, as all who use the lane do.
void Ask(Lane* lane, const std::vector<std::string>& question, const std::string& sha256) {
  lane->Send(question);
  for (int silences = 0;;) {
    std::vector<zmq::message_t> frames(1);
    if (!lane->socket.recv(frames.back())) {
      TREM_CHECK_MSG(++silences < kSilencesMax, "a valid question is not answered any more");
      lane->Send(question);
      continue;
    }
    while (frames.back().more()) TREM_CHECK(lane->socket.recv(frames.emplace_back()).has_value());
    TREM_CHECK(frames.size() == 2 || frames.size() == 3);
    const auto answer = trem::DecodeEnvelope(frames[0].to_string_view(), frames[1].to_string_view());
    TREM_CHECK_MSG(answer.ok(), answer.status().ToString());
    if (answer->has_chunk()) TREM_CHECK(frames.size() == 3 && trem::Xxh3(frames[2].to_string_view()) == answer->chunk().data_xxh3());
    if (!answer->has_put_reply()) continue;
    if (answer->put_reply().is_stored()) {
      std::uint64_t size = 0;
      const auto object = lane->store.Find(answer->put_reply().sha256(), &size);
      TREM_CHECK_MSG(object.ok(), object.status().ToString());
      const auto bytes = trem::ReadFile(*object, 1 << 20);
      TREM_CHECK_MSG(bytes.ok() && trem::Sha256Hex(*bytes) == answer->put_reply().sha256(), "what is stored has another digest");
    }
    if (answer->put_reply().sha256() == sha256) return;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static std::unique_ptr<Lane> lane;
  static unsigned count = 0;
  if (count++ % kInputsAServer == 0) lane.reset();
  if (!lane) lane = std::make_unique<Lane>();
  Input input({reinterpret_cast<const char*>(data), size});
  std::string sha256 = trem::Sha256Hex("");
  for (int i = 0; i < kMessagesMax && !input.is_empty(); ++i) lane->Send(MakeMessage(&input, &sha256));
  // Unlike whatever the input asks for.
  trem::v1::Envelope question;
  question.mutable_put_chunk()->set_sha256(trem::Sha256Hex("question " + std::to_string(count)));
  question.mutable_put_chunk()->set_bytes(1 << 20);
  question.mutable_put_chunk()->set_data_xxh3(trem::Xxh3(""));
  Ask(lane.get(), {Header(), trem::EncodeEnvelope(question).body, ""}, question.put_chunk().sha256());
  return 0;
}
