// Goal: a compute process that has gone mad cannot take the worker with it: whatever it writes to the socket pair is frames or an error.
// Method: the bytes in two pieces through a real socket pair; frames that come out, encoded again, are the bytes that went in.
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <string>

#include "mosaic/base/check.h"
#include "worker/app/compute_protocol.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 1 || size > 32'768) return 0;
  const std::size_t cut = data[0] * size / 256;
  std::array<int, 2> pair{};
  TREM_CHECK(::socketpair(AF_UNIX, SOCK_STREAM, 0, pair.data()) == 0);
  trem::ComputeFrameReader reader;
  std::string seen;
  bool is_broken = false;
  for (const auto& [begin, end] : {std::pair(std::size_t{0}, cut), std::pair(cut, size)}) {
    if (end > begin) TREM_CHECK(::send(pair[0], data + begin, end - begin, MSG_NOSIGNAL) == static_cast<ssize_t>(end - begin));
    TREM_CHECK(reader.ReadAvailable(pair[1]));
    while (!is_broken) {
      const auto frame = reader.Next();
      is_broken = !frame.ok();
      if (is_broken || !frame->has_value()) break;
      const auto bytes = static_cast<std::uint32_t>((*frame)->body.size());
      seen += static_cast<char>((*frame)->kind);
      for (int shift = 0; shift < 32; shift += 8) seen += static_cast<char>((bytes >> shift) & 0xff);
      seen += (*frame)->body;
    }
  }
  TREM_CHECK(seen == std::string(reinterpret_cast<const char*>(data), seen.size()));
  ::close(pair[0]);
  TREM_CHECK(!reader.ReadAvailable(pair[1]));
  ::close(pair[1]);
  return 0;
}
