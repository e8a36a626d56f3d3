# Kernels that step blocks of cells, compiled once for each instruction set and chosen at run time. Their files
# contain nothing else, so that no other code is compiled for a processor that may not be there (a test looks).
set(kernels ${CMAKE_SOURCE_DIR}/cellmodels/population/kernels)
set(kernel_flags -O3 -ffp-contract=fast)
if(WIGGERS_SANITIZE)
  # Everything is inlined into a few large functions, which take half an hour to compile instrumented. What they read
  # and write is checked by their callers' tests without sanitizers.
  list(APPEND kernel_flags -fno-sanitize=all)
endif()
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  set(avx2 -mavx2 -mfma)
  set(avx512 -mavx512f -mavx512dq -mavx512vl -mavx512bw -mfma)
  # False positives inside GCC 12's own AVX-512 headers.
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    list(APPEND avx512 -Wno-uninitialized -Wno-maybe-uninitialized)
  endif()
  set_source_files_properties(${kernels}_avx2.cpp PROPERTIES COMPILE_OPTIONS "${kernel_flags};${avx2}")
  set_source_files_properties(${kernels}_avx512.cpp PROPERTIES COMPILE_OPTIONS "${kernel_flags};${avx512}")
  target_compile_definitions(wiggers_core PRIVATE WIGGERS_X86_KERNELS)
  target_compile_definitions(wiggers_cellmodels PRIVATE WIGGERS_X86_KERNELS)
else()
  set_source_files_properties(${kernels}_avx2.cpp ${kernels}_avx512.cpp PROPERTIES HEADER_FILE_ONLY ON)
endif()
set_source_files_properties(${kernels}_baseline.cpp PROPERTIES COMPILE_OPTIONS "${kernel_flags}")
