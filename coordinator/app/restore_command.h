#pragma once

namespace trem {

// `trem-coordinator restore`: puts a backup in the place of the log in a state folder that no coordinator uses. Returns the exit code.
int RunRestoreCommand(int argc, char** argv);

}  // namespace trem
