// The Python module wiggers._core: the toolkit's studies of cells, force, loop and heart.
#include <wiggers/core/files.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/heart/summary.hpp>

#include "common.hpp"

PYBIND11_MODULE(_core, m) {
  m.doc() = "The compiled part of wiggers; use the names of the package.";
  m.attr("version_text") = wiggers::version_text();
  // Ctrl-C is looked for within beats, too, on the thread that imports.
  wiggers::set_interrupt_poll(&wiggers::python::check_signals);
  m.def(
      "write_file",
      [](const std::string& path, const pybind11::bytes& content) {
        const std::string bytes = content;
        pybind11::gil_scoped_release unlock;
        wiggers::write_file_atomically(path, bytes);
      },
      pybind11::arg("path"), pybind11::arg("content"),
      "Writes a file whole or not at all: an earlier one is kept until then, and its mode; devices are "
      "written through.");
  m.def(
      "read_file", [](const std::string& path) { return pybind11::bytes(wiggers::read_file(path)); },
      pybind11::arg("path"),
      "The content of a file; a pipe is read once, and refused where it does not end.");
  wiggers::python::bind_common(m);
  wiggers::python::bind_cell(m);
  wiggers::python::bind_force(m);
  wiggers::python::bind_loop(m);
  wiggers::python::bind_heart(m);
}
