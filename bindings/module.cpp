// The Python module wiggers._core: the toolkit's studies of cells, force, loop and heart.
#include <wiggers/heart/summary.hpp>

#include "common.hpp"

PYBIND11_MODULE(_core, m) {
  m.doc() = "The compiled part of wiggers; use the names of the package.";
  m.attr("version_text") = wiggers::version_text();
  wiggers::python::bind_common(m);
  wiggers::python::bind_cell(m);
  wiggers::python::bind_force(m);
  wiggers::python::bind_loop(m);
  wiggers::python::bind_heart(m);
}
