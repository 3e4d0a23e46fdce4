#pragma once

#include <sqlite3.h>

#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <memory>
#include <string>

#include "mosaic/base/status.h"

namespace trem::sqlite {

struct DatabaseCloser {
  void operator()(sqlite3* database) const { sqlite3_close(database); }
};
struct StatementFinalizer {
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using Database = std::unique_ptr<sqlite3, DatabaseCloser>;
using Statement = std::unique_ptr<sqlite3_stmt, StatementFinalizer>;

// What SQLite says, as a Status that names the file.
Status FromSqlite(sqlite3* database, const std::filesystem::path& path, const std::string& what);
Result<Statement> Prepare(sqlite3* database, const std::filesystem::path& path, const char* sql);
// Runs a statement to its end and returns the first column of its first row, 0 without rows.
Result<std::int64_t> Run(sqlite3* database, const std::filesystem::path& path, const char* sql);
Status RunAll(sqlite3* database, const std::filesystem::path& path, std::initializer_list<const char*> statements);

}  // namespace trem::sqlite
