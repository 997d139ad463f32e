// Which of the revisions that are at work beside one another come too late.
#include "named_revisions.hpp"

#include <gtest/gtest.h>

#include <memory>

namespace field_phenotyping {
namespace {

BlockHeader tile(std::uint32_t revision, bool final = false, std::uint64_t began = 1U, int x = 0) {
  BlockHeader header;
  header.index = {x, 0};
  header.began_ns = began;
  header.revision = revision;
  header.final = final;
  return header;
}

TEST(NamedRevisions, OlderOnesOfTheSamePassAreOvertaken) {
  NamedRevisions revisions;
  EXPECT_FALSE(revisions.isOvertaken(tile(1U)));
  revisions.name(tile(2U));
  EXPECT_TRUE(revisions.isOvertaken(tile(1U)));
  EXPECT_FALSE(revisions.isOvertaken(tile(2U))) << "worked again for new parameters";
  EXPECT_FALSE(revisions.isOvertaken(tile(3U)));
  EXPECT_FALSE(revisions.isOvertaken(tile(1U, false, 2U))) << "another pass";
  EXPECT_FALSE(revisions.isOvertaken(tile(1U, false, 1U, 1))) << "another tile";
}

TEST(NamedRevisions, ADraftBesideAFinalBlockIsOvertakenByIt) {
  NamedRevisions revisions;
  auto draft = std::make_unique<NamedRevisions::Work>(revisions);
  {
    const NamedRevisions::Work final_block(revisions);
    revisions.name(tile(2U, true));
  }
  EXPECT_TRUE(revisions.isOvertaken(tile(1U)));
  draft.reset();
  EXPECT_FALSE(revisions.isOvertaken(tile(1U))) << "nothing is left that could come too late";
  const NamedRevisions::Work open_block(revisions);
  revisions.name(tile(5U, false, 1U, 7));
  { const NamedRevisions::Work other(revisions); }
  EXPECT_TRUE(revisions.isOvertaken(tile(4U, false, 1U, 7))) << "while the tile is open";
}

}  // namespace
}  // namespace field_phenotyping
