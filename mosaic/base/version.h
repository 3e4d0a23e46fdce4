#pragma once

namespace trem {

// Part of every task key: raise it whenever a task's output bytes change for the same input, so that stored results of the older
// engine are not taken for this one's.
inline constexpr const char* kEngineRevision = "9";

// Version of the messages between coordinator, workers and clients; peers of another version are refused.
inline constexpr unsigned kProtocolVersion = 2;

}  // namespace trem
