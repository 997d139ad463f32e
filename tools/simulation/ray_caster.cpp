#include "simulation/ray_caster.hpp"

#include <embree3/rtcore.h>

#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>

namespace field_phenotyping::simulation {

struct RayCaster::EmbreeScene {
  RTCDevice device;
  RTCScene scene;

  EmbreeScene() {
    // One build thread: the order of triangles in the hierarchy, and with it which of two
    // triangles wins an exact tie, then does not depend on the machine's cores.
    device = rtcNewDevice("threads=1");
    if (device == nullptr) {
      throw std::runtime_error("Embree could not start: its library or the CPU is unsupported");
    }
    scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_MEDIUM);
  }
  ~EmbreeScene() {
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
  }
  EmbreeScene(const EmbreeScene&) = delete;
  EmbreeScene& operator=(const EmbreeScene&) = delete;
};

RayCaster::RayCaster(const TriangleMesh& mesh)
    : scene_(std::make_unique<EmbreeScene>()), mesh_(&mesh) {
  RTCGeometry geometry = rtcNewGeometry(scene_->device, RTC_GEOMETRY_TYPE_TRIANGLE);
  void* vertices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                           sizeof(Eigen::Vector3f), mesh.vertices.size());
  void* triangles = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                            sizeof(mesh.triangles.front()), mesh.triangles.size());
  if (vertices == nullptr || triangles == nullptr) {
    rtcReleaseGeometry(geometry);
    throw std::runtime_error("not enough memory for the field's " +
                             std::to_string(mesh.triangles.size()) +
                             " triangles: simulate fewer plants");
  }
  std::memcpy(vertices, mesh.vertices.data(), mesh.vertices.size() * sizeof(Eigen::Vector3f));
  std::memcpy(triangles, mesh.triangles.data(),
              mesh.triangles.size() * sizeof(mesh.triangles.front()));
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(scene_->scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(scene_->scene);
}

RayCaster::~RayCaster() = default;
RayCaster::RayCaster(RayCaster&&) noexcept = default;
RayCaster& RayCaster::operator=(RayCaster&&) noexcept = default;

std::optional<RayHit> RayCaster::cast(const Eigen::Vector3d& origin,
                                      const Eigen::Vector3d& direction, double max_range) const {
  const Eigen::Vector3f o = origin.cast<float>();
  const Eigen::Vector3f d = direction.cast<float>();
  RTCRayHit query{};
  query.ray.org_x = o.x();
  query.ray.org_y = o.y();
  query.ray.org_z = o.z();
  query.ray.dir_x = d.x();
  query.ray.dir_y = d.y();
  query.ray.dir_z = d.z();
  query.ray.tnear = 0.0F;
  query.ray.tfar = static_cast<float>(max_range);
  query.ray.mask = 0xffffffffU;
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(scene_->scene, &context, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
    return std::nullopt;
  }
  const Eigen::Vector3d normal =
      Eigen::Vector3f(query.hit.Ng_x, query.hit.Ng_y, query.hit.Ng_z).cast<double>().normalized();
  RayHit hit;
  hit.range = static_cast<double>(query.ray.tfar);
  hit.cosine = std::abs(normal.dot(direction));
  hit.surface = mesh_->triangle_surface[query.hit.primID];
  return hit;
}

}  // namespace field_phenotyping::simulation
