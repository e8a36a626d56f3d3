// The Python module wiggers._core: the toolkit's studies of cells, force, loop and heart.
#include <wiggers/core/files.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/heart/run/summary.hpp>

#include "common.hpp"

namespace {
void require_replaceable(const std::string& path, wiggers::FileKind kind) {
  if (!wiggers::is_replaceable(path, kind)) wiggers::refuse_other_kind(path, "save", kind);
}
}  // namespace

PYBIND11_MODULE(_core, m) {
  m.doc() = "The compiled part of wiggers; use the names of the package.";
  m.attr("version_text") = wiggers::version_text();
  // Ctrl-C is looked for within beats, too, on the thread that imports.
  wiggers::set_interrupt_poll(&wiggers::python::check_signals);
  pybind11::enum_<wiggers::FileKind>(m, "FileKind",
                                     "What a file holds; one is replaced only by its own kind.")
      .value("state", wiggers::FileKind::state)
      .value("picture", wiggers::FileKind::picture)
      .value("page", wiggers::FileKind::page);
  m.def(
      "write_file",
      [](const std::string& path, const pybind11::bytes& content, wiggers::FileKind kind) {
        require_replaceable(path, kind);
        const std::string bytes = content;
        pybind11::gil_scoped_release unlock;
        wiggers::write_file_atomically(path, bytes);
      },
      pybind11::arg("path"), pybind11::arg("content"), pybind11::arg("kind"),
      "Writes a file whole or not at all: an earlier one is kept until then, and its mode; one of another "
      "kind is "
      "never replaced; devices are written through.");
  m.def("kind_of_report_file", &wiggers::kind_of_report_file, pybind11::arg("name"), "Page or picture.");
  m.def("require_replaceable", &require_replaceable, pybind11::arg("path"), pybind11::arg("kind"),
        "Refuses a path at which a file of another kind stands.");
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
