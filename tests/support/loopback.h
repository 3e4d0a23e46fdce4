#pragma once

#include <chrono>
#include <string>

namespace trem::testing {

// A TCP connection to 127.0.0.1 at the port that ends `url` ("tcp://127.0.0.1:1234", "http://127.0.0.1:1234"); aborts the test program when
// there is none. Receiving gives up after 20 s. The caller closes it.
int ConnectLoopback(const std::string& url);

// A TCP port that nothing listened at a moment ago.
int FreeLoopbackPort();

// Sends `request` and returns everything that comes back until the other side closes.
std::string Exchange(const std::string& url, const std::string& request);

// The whole answer, head and body, to GET `path`.
std::string HttpGet(const std::string& url, const std::string& path);

}  // namespace trem::testing
