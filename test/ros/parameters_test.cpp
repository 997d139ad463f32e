#include <field_phenotyping/CompletionConfig.h>
#include <field_phenotyping/MeasurementConfig.h>
#include <field_phenotyping/PreprocessingConfig.h>
#include <field_phenotyping/SegmentationConfig.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "parameter_server.hpp"

namespace field_phenotyping {
namespace {

template <class ConfigType, class SectionType>
struct Stage {
  using Config = ConfigType;
  using Section = SectionType;
};

template <class Stage>
class Cfg : public ::testing::Test {};
using Stages = ::testing::Types<Stage<PreprocessingConfig, PreprocessingParameters>,
                                Stage<SegmentationConfig, SegmentationParameters>,
                                Stage<CompletionConfig, CompletionParameters>,
                                Stage<MeasurementConfig, MeasurementParameters>>;
TYPED_TEST_SUITE(Cfg, Stages, );

/// Compares every value of the section with the one of that name in `message`.
template <class Section, class Expected>
void expectValues(const dynamic_reconfigure::Config& message, Expected&& expected) {
  Section section;
  Section::visit(section, [&](const ParameterInfo& info, auto& value, auto low, auto high) {
    std::decay_t<decltype(value)> found{};
    ASSERT_TRUE(dynamic_reconfigure::ConfigTools::getParameter(message, info.name, found))
        << info.name << " is missing in the .cfg, or has another type there";
    expected(info.name, value, low, high, found);
  });
}

TYPED_TEST(Cfg, HasTheDefaultsOfTheCore) {
  dynamic_reconfigure::Config message;
  TypeParam::Config::__getDefault__().__toMessage__(message);
  expectValues<typename TypeParam::Section>(
      message, [](const char* name, const auto& value, auto, auto, const auto& found) {
        EXPECT_EQ(value, found) << name;
      });
}

TYPED_TEST(Cfg, HasTheRangesOfTheCore) {
  dynamic_reconfigure::Config lowest, highest;
  TypeParam::Config::__getMin__().__toMessage__(lowest);
  TypeParam::Config::__getMax__().__toMessage__(highest);
  const auto compare = [](const char* name, const auto& value, const auto& bound,
                          const auto& found) {
    if constexpr (std::is_arithmetic_v<std::decay_t<decltype(value)>>) {
      EXPECT_EQ(bound, found) << name;
    }
  };
  expectValues<typename TypeParam::Section>(
      lowest, [&](const char* name, const auto& value, auto low, auto, const auto& found) {
        compare(name, value, low, found);
      });
  expectValues<typename TypeParam::Section>(
      highest, [&](const char* name, const auto& value, auto, auto high, const auto& found) {
        compare(name, value, high, found);
      });
}

TYPED_TEST(Cfg, HasNoOthersAndSaysMeaningAndUnit) {
  std::map<std::string, std::string> said;
  for (const auto& entry : TypeParam::Config::__getParamDescriptions__()) {
    said[entry->name] = entry->description;
  }
  typename TypeParam::Section section;
  std::size_t count = 0U;
  TypeParam::Section::visit(section, [&](const ParameterInfo& info, auto&, auto, auto) {
    ++count;
    const std::string unit = info.unit;
    const std::string expected = info.description + (unit.empty() ? "" : " [" + unit + "]");
    EXPECT_EQ(said[info.name], expected);
  });
  EXPECT_EQ(said.size(), count);
}

TYPED_TEST(Cfg, SurvivesTheWayThereAndBack) {
  auto config = TypeParam::Config::__getDefault__();
  auto section = toSection<typename TypeParam::Section>(TypeParam::Config::__getMax__());
  assign(section, config);
  const auto back = toSection<typename TypeParam::Section>(config);
  std::vector<std::string> there, again;
  const auto list = [](auto& values, std::vector<std::string>& into) {
    std::decay_t<decltype(values)>::visit(
        values, [&](const ParameterInfo& info, const auto& value, auto, auto) {
          std::ostringstream text;
          text << info.name << "=" << value;
          into.push_back(text.str());
        });
  };
  list(section, there);
  list(back, again);
  EXPECT_EQ(there, again);
}

TEST(Corrected, LeavesValidParametersAlone) {
  SegmentationParameters wanted;
  wanted.M = 0.7;
  EXPECT_EQ(corrected(wanted, SegmentationParameters()).M, 0.7);
}

TEST(Corrected, PutsOneOfTwoContradictingValuesBack) {
  SegmentationParameters wanted;
  wanted.M = 0.7;
  wanted.seed_min_height = 1.9;
  ASSERT_FALSE(violations(wanted).empty());
  const auto result = corrected(wanted, SegmentationParameters());
  EXPECT_TRUE(violations(result).empty());
  EXPECT_EQ(result.M, 0.7) << "values that are well must stay";
}

TEST(Corrected, GivesUpWhenSeveralAreWrong) {
  PreprocessingParameters wanted;
  wanted.min_range = 50.0;
  wanted.min_x = 5.0;
  wanted.max_x = 4.0;
  const auto result = corrected(wanted, PreprocessingParameters());
  EXPECT_TRUE(violations(result).empty());
}

TEST(Corrected, DoesNotLetNanThrough) {
  SegmentationParameters wanted;
  wanted.r1 = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(corrected(wanted, SegmentationParameters()).r1, SegmentationParameters().r1);
}

}  // namespace
}  // namespace field_phenotyping
