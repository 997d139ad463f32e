# The core under the name that it has where it is installed without ROS.
if(NOT TARGET field_phenotyping::core)
  add_library(field_phenotyping::core INTERFACE IMPORTED)
  set_target_properties(field_phenotyping::core PROPERTIES
    INTERFACE_INCLUDE_DIRECTORIES "${field_phenotyping_INCLUDE_DIRS}"
    INTERFACE_LINK_LIBRARIES "${field_phenotyping_LIBRARIES}")
endif()
