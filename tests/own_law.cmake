# The recipe of tissue/laws/material.hpp, followed: a copy of the laws with one of one's own, built and tested
# (tissue/own_law.cpp). Its header, its include, its entry.
include(own_copy.cmake)
own_copy(tissue/laws own_law)
configure_file(tissue/demiray.hpp ${own_law_include}/wiggers/tissue/laws/demiray.hpp COPYONLY)
own_line(own_law/tissue/laws/material.hpp "#include <wiggers/tissue/laws/holzapfel_ogden.hpp>"
         "#include <wiggers/tissue/laws/demiray.hpp>\n#include <wiggers/tissue/laws/holzapfel_ogden.hpp>")
own_line(own_law/tissue/laws/material.hpp "(using MaterialKinds = std::tuple<)" "\\1DemirayMaterial, ")
wiggers_test(own_law wiggers::core tissue/own_law.cpp ${own_law_sources})
target_include_directories(test_own_law BEFORE PRIVATE ${own_law_include})
