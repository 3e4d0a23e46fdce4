#include "coordinator/store/sqlite.h"

#include <cerrno>
#include <cstring>

namespace trem::sqlite {

Status FromSqlite(sqlite3* database, const std::filesystem::path& path, const std::string& what) {
  const int code = sqlite3_extended_errcode(database);
  const int system_error = sqlite3_system_errno(database);
  const std::string text = "cannot " + what + " " + path.string() + ": " + sqlite3_errmsg(database);
  switch (code & 0xff) {
    case SQLITE_FULL:
      return Exhausted(text + "; make room on its disk and start again, nothing that was acknowledged is lost");
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return Unavailable(text + "; another program has it open");
    case SQLITE_CORRUPT:
      return Corrupt(text + "; restore it from a copy or choose another --state folder");
    case SQLITE_NOTADB:
      return Corrupt(text + "; move the file away or choose another --state folder");
    case SQLITE_READONLY:
    case SQLITE_PERM:
    case SQLITE_CANTOPEN:
      return InvalidInput(text + "; check its permissions");
    default:
      if (system_error == ENOSPC || system_error == EDQUOT || system_error == EFBIG) {
        return Exhausted(text + " (" + std::strerror(system_error) + "); make room on its disk and start again");
      }
      return Failed(text);
  }
}

Result<Statement> Prepare(sqlite3* database, const std::filesystem::path& path, const char* sql) {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(database, sql, -1, &statement, nullptr) != SQLITE_OK) return FromSqlite(database, path, "read");
  return Statement(statement);
}

Result<std::int64_t> Run(sqlite3* database, const std::filesystem::path& path, const char* sql) {
  TREM_ASSIGN_OR_RETURN(const Statement statement, Prepare(database, path, sql));
  std::int64_t value = 0;
  bool first = true;
  int code = SQLITE_ROW;
  while ((code = sqlite3_step(statement.get())) == SQLITE_ROW) {
    if (first) value = sqlite3_column_int64(statement.get(), 0);
    first = false;
  }
  if (code != SQLITE_DONE) return FromSqlite(database, path, "use");
  return value;
}

Status RunAll(sqlite3* database, const std::filesystem::path& path, std::initializer_list<const char*> statements) {
  for (const char* sql : statements) {
    if (const auto result = Run(database, path, sql); !result.ok()) return result.status();
  }
  return {};
}

}  // namespace trem::sqlite
