// Goal: no path of a spec is forgotten when files are checked, moved or copied. Method: the schema's own list of fields: every text field
// called "path" or "..._path" is set, one at a time, and has to be found.
#include "proto/codec/sortie_paths.h"

#include <google/protobuf/descriptor.h>
#include <gtest/gtest.h>

#include <string>

namespace trem {
namespace {

using google::protobuf::FieldDescriptor;

// Sets each path field below `message` to "x" in turn and compares what is found in `sortie`; counts them.
int CheckFields(google::protobuf::Message* message, const std::string& prefix, v1::Sortie* sortie) {
  int count = 0;
  for (int i = 0; i < message->GetDescriptor()->field_count(); ++i) {
    const FieldDescriptor* field = message->GetDescriptor()->field(i);
    const std::string name = prefix + field->name();
    if (field->is_repeated()) {
      if (field->cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE) continue;
      count += CheckFields(message->GetReflection()->AddMessage(message, field), name + ".", sortie);
      message->GetReflection()->ClearField(message, field);
    } else if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      count += CheckFields(message->GetReflection()->MutableMessage(message, field), name + ".", sortie);
    } else if (field->cpp_type() == FieldDescriptor::CPPTYPE_STRING && name.ends_with("path")) {
      message->GetReflection()->SetString(message, field, "x");
      const std::vector<SortiePath> paths = PathsOf(sortie);
      EXPECT_EQ(paths.size(), 1U) << name;
      EXPECT_EQ(paths.empty() ? std::string() : paths[0].field, name);
      message->GetReflection()->ClearField(message, field);
      ++count;
    }
  }
  return count;
}

TEST(SortiePathsTest, FindsEveryPathOfTheSchema) {
  v1::Sortie sortie;
  EXPECT_GE(CheckFields(&sortie, "", &sortie), 11);
}

TEST(SortiePathsTest, LeavesASpecWithoutPathsAsItIs) {
  v1::Sortie sortie;
  EXPECT_TRUE(PathsOf(&sortie).empty());
  EXPECT_EQ(sortie.ByteSizeLong(), 0U);
  EXPECT_FALSE(sortie.has_mosaic());
}

TEST(SortiePathsTest, GivesTheSpecsOwnText) {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path("leg.ts");
  sortie.mutable_mosaic()->set_cutline_path("area.geojson");
  for (const SortiePath& named : PathsOf(&sortie)) *named.path = "/flights/" + *named.path;
  EXPECT_EQ(sortie.source().path(), "/flights/leg.ts");
  EXPECT_EQ(sortie.mosaic().cutline_path(), "/flights/area.geojson");
}

}  // namespace
}  // namespace trem
