# What find_package(field_phenotyping) finds after `cmake --install` without ROS. Component `core`.
# catkin_lint reads it too: it is to leave alone what is not installed where catkin would.
include(CMakePackageConfigHelpers)
set(package_destination ${CMAKE_INSTALL_LIBDIR}/cmake/${PROJECT_NAME})
set_target_properties(field_phenotyping_core PROPERTIES EXPORT_NAME core)
install(TARGETS field_phenotyping_core EXPORT field_phenotyping-targets
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT core
  LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT core
)
#catkin_lint: ignore_once wrong_install_destination
install(DIRECTORY include/${PROJECT_NAME} DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}" COMPONENT core)
install(EXPORT field_phenotyping-targets
  NAMESPACE field_phenotyping::
  DESTINATION ${package_destination} COMPONENT core
)

# A shared library has what it needs; a static one leaves it to whoever links it.
get_target_property(library_type field_phenotyping_core TYPE)
set(FIELD_PHENOTYPING_NEEDS_TBB FALSE)
set(FIELD_PHENOTYPING_NEEDS_CUDA FALSE)
if(library_type STREQUAL "STATIC_LIBRARY")
  if(TARGET TBB::tbb)
    set(FIELD_PHENOTYPING_NEEDS_TBB TRUE)
  endif()
  set(FIELD_PHENOTYPING_NEEDS_CUDA ${FIELD_PHENOTYPING_HAS_CUDA})
endif()
configure_package_config_file(cmake/field_phenotyping-config.cmake.in
  ${CMAKE_CURRENT_BINARY_DIR}/field_phenotyping-config.cmake
  INSTALL_DESTINATION ${package_destination}
)
write_basic_package_version_file(${CMAKE_CURRENT_BINARY_DIR}/field_phenotyping-config-version.cmake
  COMPATIBILITY SameMinorVersion
)
#catkin_lint: ignore_once wrong_install_destination missing_file
install(FILES
  ${CMAKE_CURRENT_BINARY_DIR}/field_phenotyping-config.cmake
  ${CMAKE_CURRENT_BINARY_DIR}/field_phenotyping-config-version.cmake
  DESTINATION ${package_destination} COMPONENT core
)
