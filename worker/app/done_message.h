#pragma once

#include <string>

#include "proto/trem/v1/fleet.pb.h"
#include "worker/app/compute_thread.h"

namespace trem {

// The first 4096 bytes of a text that may be anything (file names, what native code prints), as UTF-8: other bytes become U+FFFD, since a
// text that is not UTF-8 would make the whole message unreadable.
std::string ToMessageText(const std::string& text);

// The Done of an attempt. Always a valid envelope: texts become UTF-8 and are cut to a length that suits a message, and a result that
// breaks the contract (say, a count that is not finite) becomes a kFailed that says so.
v1::Envelope MakeDone(const v1::TaskAttempt& attempt, const ComputeThread::Finished& finished);

}  // namespace trem
