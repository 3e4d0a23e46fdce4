// Goal: the documents do not fall behind the program.
// Method: every field of a sortie spec, read from the schema's descriptor, must be named in the user guide, and every folder of the include
// table in the architecture.

#include <google/protobuf/descriptor.h>

#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "proto/trem/v1/job.pb.h"
#include "tests/layering/layering_rules.h"

namespace trem::layering {
namespace {

std::string ReadDocument(const std::string& name) {
  std::ifstream file(std::string(TREM_SOURCE_DIR) + "/docs/" + name);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

// Paths such as "tre.ratio" of all fields that hold a value.
void AppendFieldPaths(const google::protobuf::Descriptor& message, const std::string& prefix, std::vector<std::string>* paths) {
  for (int i = 0; i < message.field_count(); ++i) {
    const google::protobuf::FieldDescriptor& field = *message.field(i);
    // A list of messages is one field to the reader: its parts are those of fields that the table has.
    if (field.message_type() != nullptr && !field.is_repeated()) {
      AppendFieldPaths(*field.message_type(), prefix + field.name() + ".", paths);
    } else {
      paths->push_back(prefix + field.name());
    }
  }
}

TEST(DocsTest, TheUserGuideNamesEveryFieldOfTheSpec) {
  const std::string guide = ReadDocument("USER_GUIDE.md");
  std::vector<std::string> paths;
  AppendFieldPaths(*v1::Sortie::descriptor(), "", &paths);
  ASSERT_GT(paths.size(), 20U);
  for (const std::string& path : paths) EXPECT_THAT(guide, testing::HasSubstr("`" + path + "`"));
}

TEST(DocsTest, TheArchitectureNamesEveryFolderOfTheIncludeTable) {
  const std::string architecture = ReadDocument("ARCHITECTURE.md");
  for (const std::string& folder : Folders()) EXPECT_THAT(architecture, testing::HasSubstr("`" + folder + "`"));
}

}  // namespace
}  // namespace trem::layering
