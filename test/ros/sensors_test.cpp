// Against field_phenotyping.launch: sensors, drivers and SLAMs as they are about.
#include <gtest/gtest.h>

#include "field_client.hpp"

namespace field_phenotyping {
namespace {

class Sensors : public ::testing::Test {
 protected:
  using Sensor = testing::FieldClient::Sensor;

  static void SetUpTestSuite() {
    client_ = new testing::FieldClient();
    ASSERT_TRUE(client_->waitForStages());
  }
  static void TearDownTestSuite() { delete client_; }

  static double dropped() {
    double sum = 0.0;
    for (const char* why : {"no transform", "queue full", "unreadable", "failed"}) {
      sum += client_->valueOf("preprocessing", std::string("scans dropped: ") + why);
    }
    return sum;
  }

  /// Drives past, which takes so long, and compares what is found with the truth.
  static void expectAllPlants(const Sensor& sensor, double seconds) {
    const double dropped_before = dropped();
    const double jumps_before = client_->valueOf("preprocessing", "map jumps");
    client_->forgetPlants();
    client_->driveBy(static_cast<int>(seconds * sensor.rate), sensor, Eigen::Vector3d::Zero(),
                     back_);
    back_ = !back_;  // from where it is: else the map seems to jump
    EXPECT_TRUE(client_->waitFor([] { return client_->foundEveryPlant(); }, 40.0));
    client_->expectTruth();
    client_->spinFor(1.5);  // diagnostics come once a second
    EXPECT_EQ(dropped(), dropped_before);
    EXPECT_EQ(client_->valueOf("preprocessing", "map jumps"), jumps_before);
  }

  static testing::FieldClient* client_;
  static bool back_;
};
bool Sensors::back_ = false;
testing::FieldClient* Sensors::client_ = nullptr;

TEST_F(Sensors, AtTwentyHertz) {
  Sensor sensor;
  sensor.rate = 20.0;
  expectAllPlants(sensor, 3.0);
}

TEST_F(Sensors, AtFiveHertz) {
  Sensor sensor;
  sensor.rate = 5.0;
  expectAllPlants(sensor, 4.0);
}

TEST_F(Sensors, WithTransformsHalfASecondLate) {
  Sensor sensor;
  sensor.tf_late = 0.5;
  expectAllPlants(sensor, 3.0);
}

// The path between them is straight, so that plants are blurred where the rover speeds up.
TEST_F(Sensors, WithFiveTransformsASecond) {
  Sensor sensor;
  sensor.tf_rate = 5.0;
  expectAllPlants(sensor, 6.0);
}

TEST_F(Sensors, WithTheFieldsOfUsualDrivers) {
  for (const char* driver : {"velodyne", "ouster", "hesai"}) {
    SCOPED_TRACE(driver);
    Sensor sensor;
    sensor.layout = driver;
    expectAllPlants(sensor, 3.0);
  }
}

// As of a bag that starts again, whose scans a SLAM places in a new map: what it said before of
// these times must not be believed.
TEST_F(Sensors, WhoseTimeIsSetBackArePlacedByWhatIsSaidFromThenOn) {
  const double dropped_before = dropped();
  const Eigen::Vector3d shift(0.0, 40.0, 0.0);
  client_->forgetPlants();
  client_->setTimeBack(15.0);
  client_->driveBy(30, shift, back_);
  back_ = !back_;
  EXPECT_TRUE(client_->waitFor([] { return client_->foundEveryPlant(); }, 40.0));
  client_->expectTruth(shift);
  client_->spinFor(1.5);
  EXPECT_EQ(dropped(), dropped_before);
  EXPECT_EQ(client_->valueOf("preprocessing", "time jumps of tf"), 1.0);
}

TEST_F(Sensors, WithTransformsLaterThanScansWaitAreToldHowLongToWait) {
  Sensor sensor;
  sensor.tf_late = 1.6;
  client_->driveBy(30, sensor);
  EXPECT_TRUE(client_->waitFor(
      [] {
        return client_->heardOf("preprocessing",
                                "s older than the scan. Has the SLAM stopped? If "
                                "it is late, raise tf_timeout by more than that");
      },
      10.0));
}

}  // namespace
}  // namespace field_phenotyping
