#pragma once

#include <CLI/CLI.hpp>

#include "mosaic/base/exit_code.h"

namespace trem {

// Ends a command whose line could not be parsed: prints the help that was asked for, or what is wrong with the line and where to look.
// Returns the exit code.
inline int ExitOfParseError(CLI::App* app, const CLI::ParseError& error) {
  app->failure_message([](const CLI::App* command, const CLI::Error& wrong) {
    return command->get_name() + ": " + wrong.what() + ". See '" + command->get_name() + " --help'\n";
  });
  return app->exit(error) == 0 ? kExitDone : kExitUsage;
}

}  // namespace trem
