# WITH_CUDA: AUTO takes nvcc where there is one, ON insists on it, OFF goes without. Sets
# FIELD_PHENOTYPING_HAS_CUDA. The flags for architectures are our own, since CMake 3.16 has none.
set(WITH_CUDA AUTO CACHE STRING "Build the GPU code: AUTO, ON or OFF")
set_property(CACHE WITH_CUDA PROPERTY STRINGS AUTO ON OFF)
set(FIELD_PHENOTYPING_CUDA_ARCHITECTURES "75;80;86;89;90" CACHE STRING
  "Compute capabilities, without their dot, that GPU code is built for")
set(FIELD_PHENOTYPING_HAS_CUDA FALSE)
if(NOT WITH_CUDA STREQUAL "OFF")
  include(CheckLanguage)
  set(CMAKE_CUDA_ARCHITECTURES OFF)
  check_language(CUDA)
  if(CMAKE_CUDA_COMPILER)
    enable_language(CUDA)
    if(CMAKE_CUDA_COMPILER_VERSION VERSION_LESS 11.0)
      set(no_cuda "nvcc is ${CMAKE_CUDA_COMPILER_VERSION}, C++17 needs 11.0")
    else()
      set(FIELD_PHENOTYPING_HAS_CUDA TRUE)
    endif()
  else()
    set(no_cuda "nvcc was not found: put it on PATH, or give CMAKE_CUDA_COMPILER")
  endif()
  if(NOT FIELD_PHENOTYPING_HAS_CUDA)
    if(WITH_CUDA STREQUAL "AUTO")
      message(STATUS "No GPU code: ${no_cuda}")
    else()
      message(FATAL_ERROR "WITH_CUDA=ON, but ${no_cuda}")
    endif()
  endif()
endif()

# Flags of .cu files. As on the CPU no multiplication is fused with an addition: results are the
# same, bit for bit. Work on the default stream is an error.
set(cuda_flags -std=c++17 -fmad=false "SHELL:-Werror all-warnings,default-stream-launch"
  -Xcompiler=-Wall,-Wextra,-Werror)
foreach(architecture ${FIELD_PHENOTYPING_CUDA_ARCHITECTURES})
  list(APPEND cuda_flags
    "SHELL:-gencode arch=compute_${architecture},code=sm_${architecture}")
  set(newest_architecture ${architecture})
endforeach()
# What is newer than all of them compiles this when it is loaded.
list(APPEND cuda_flags
  "SHELL:-gencode arch=compute_${newest_architecture},code=compute_${newest_architecture}")
