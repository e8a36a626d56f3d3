# The programs that docs/embedding.md shows are those that the test of the installation builds and runs.
file(READ ${ROOT}/docs/embedding.md page)
foreach(file circulation/CMakeLists.txt circulation/coupled.cpp heart/own_wall.cpp)
  file(READ ${ROOT}/tests/install/${file} text)
  string(FIND "${page}" "\n${text}```" found)
  if(found EQUAL -1)
    message(FATAL_ERROR "docs/embedding.md does not show tests/install/${file} as it is")
  endif()
endforeach()
