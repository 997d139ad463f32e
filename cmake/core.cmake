# The algorithms: no ROS, no PCL. Needs a compiler and Eigen; TBB when there.
file(GLOB core_sources CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/src/*.cpp
  ${PROJECT_SOURCE_DIR}/src/*/*.cpp)
if(FIELD_PHENOTYPING_HAS_CUDA)
  file(GLOB cuda_sources CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/src/*/*.cu)
endif()
add_library(field_phenotyping_core ${core_sources} ${cuda_sources})
target_include_directories(field_phenotyping_core
  PUBLIC
    $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include>
    $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>
  PRIVATE ${PROJECT_SOURCE_DIR}/src)
target_link_libraries(field_phenotyping_core
  PUBLIC Eigen3::Eigen
  PRIVATE $<BUILD_INTERFACE:field_phenotyping_warnings>)
# Square roots and roundings inline: nobody asks for errno or floating-point exceptions.
# Nor does an addition take part in a multiplication unasked: results are the GPU's bit for bit.
# Nobody puts functions in place of the library's own: those are inlined within it, though it may be
# a shared one, and work with wider vectors where withWideVectors() calls them.
target_compile_options(field_phenotyping_core PRIVATE
  $<$<COMPILE_LANGUAGE:CXX>:-fno-math-errno;-fno-trapping-math;-ffp-contract=off;-fno-semantic-interposition>)
# They work with vectors wider than every processor's (common/wide_lanes.hpp says why they may).
set_source_files_properties(${PROJECT_SOURCE_DIR}/src/segmentation/leaf_bases.cpp
  ${PROJECT_SOURCE_DIR}/src/segmentation/local_shape.cpp PROPERTIES COMPILE_OPTIONS -Wno-psabi)
if(FIELD_PHENOTYPING_HAS_CUDA)
  target_compile_definitions(field_phenotyping_core PRIVATE FIELD_PHENOTYPING_WITH_CUDA)
  target_compile_options(field_phenotyping_core PRIVATE
    "$<$<COMPILE_LANGUAGE:CUDA>:${cuda_flags}>")
endif()
if(TARGET TBB::tbb)
  target_link_libraries(field_phenotyping_core PRIVATE TBB::tbb)
  target_compile_definitions(field_phenotyping_core PRIVATE FIELD_PHENOTYPING_WITH_TBB)
  if(FIELD_PHENOTYPING_SANITIZE MATCHES thread)
    # What TBB hands from thread to thread by itself would be reported; what it promises is told.
    set_source_files_properties(${PROJECT_SOURCE_DIR}/src/common/parallel_tasks.cpp PROPERTIES
      COMPILE_OPTIONS -fno-sanitize=thread
      COMPILE_DEFINITIONS FIELD_PHENOTYPING_THREAD_SANITIZER)
  endif()
else()
  message(STATUS "TBB not found: the core works on one thread")
endif()
