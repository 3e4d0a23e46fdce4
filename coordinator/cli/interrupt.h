#pragma once

namespace trem {

// From now on SIGINT, SIGTERM and SIGHUP are only counted, and interrupt blocking calls; SIGPIPE is ignored. Child processes start with
// default handling again (see child_process.h).
void CountInterrupts();

// The first signal that arrived; 0: none yet.
int InterruptSignal();
// How many arrived. Two: the user is in a hurry.
int InterruptCount();

}  // namespace trem
