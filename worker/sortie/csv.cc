#include "worker/sortie/csv.h"

namespace trem {
namespace {

std::string_view Trimmed(std::string_view text) {
  const std::size_t begin = text.find_first_not_of(" \t");
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(" \t") - begin + 1);
}

}  // namespace

CsvReader::CsvReader(std::string_view text, std::string file_name, std::size_t columns_max)
    : text_(text), file_name_(std::move(file_name)), columns_max_(columns_max) {
  if (text_.starts_with("\xef\xbb\xbf")) position_ = 3;
}

Status CsvReader::Problem(const std::string& what) const { return InvalidInput(file_name_ + ":" + std::to_string(line_) + ": " + what); }

Status CsvReader::ReadField(std::string* field) {
  field->clear();
  std::size_t begin = position_;
  while (begin < text_.size() && (text_[begin] == ' ' || text_[begin] == '\t')) ++begin;
  if (begin >= text_.size() || text_[begin] != '"') {
    std::size_t end = text_.find_first_of(",\r\n", position_);
    if (end == std::string_view::npos) end = text_.size();
    *field = Trimmed(text_.substr(position_, end - position_));
    position_ = end;
    return {};
  }
  const int first_line = line_;
  position_ = begin + 1;
  while (true) {
    if (position_ >= text_.size()) {
      line_ = first_line;
      return Problem("a quoted field is never closed; expected '\"'");
    }
    const char c = text_[position_++];
    if (c == '"') {
      if (position_ >= text_.size() || text_[position_] != '"') break;
      ++position_;
    }
    if (c == '\n') ++line_;
    field->push_back(c);
  }
  while (position_ < text_.size() && (text_[position_] == ' ' || text_[position_] == '\t')) ++position_;
  if (position_ < text_.size() && text_[position_] != ',' && text_[position_] != '\r' && text_[position_] != '\n') {
    return Problem("text after a closing quote; expected ',' or the end of the line");
  }
  return {};
}

Result<bool> CsvReader::Next(CsvRecord* record) {
  record->fields.clear();
  while (position_ < text_.size() && (text_[position_] == '\n' || text_[position_] == '\r')) {
    if (text_[position_] == '\n') ++line_;
    ++position_;
  }
  if (position_ >= text_.size()) return false;
  record->line = line_;
  while (true) {
    if (record->fields.size() == columns_max_) return Problem("more than " + std::to_string(columns_max_) + " columns");
    record->fields.emplace_back();
    TREM_RETURN_IF_ERROR(ReadField(&record->fields.back()));
    if (position_ >= text_.size() || text_[position_] != ',') return true;
    ++position_;
  }
}

}  // namespace trem
