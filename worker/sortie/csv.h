#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

struct CsvRecord {
  int line = 0;  // Where it starts, counted from 1.
  std::vector<std::string> fields;
};

// Reads the records of comma-separated text one after another (RFC 4180: fields may be quoted, "" is a quote, quoted fields may hold
// commas and line breaks; lines end in LF or CRLF). A byte order mark and empty lines are skipped. Blanks around fields are removed.
class CsvReader {
 public:
  // `text` must outlive the reader; `file_name` stands in front of errors.
  CsvReader(std::string_view text, std::string file_name, std::size_t columns_max);

  // False at the end. kInvalidInput: a quote that is never closed, text after a closing quote, too many columns.
  Result<bool> Next(CsvRecord* record);

 private:
  Status ReadField(std::string* field);
  Status Problem(const std::string& what) const;

  std::string_view text_;
  std::string file_name_;
  std::size_t columns_max_;
  std::size_t position_ = 0;
  int line_ = 1;
};

}  // namespace trem
