#include <fmt/core.h>
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <array>
#include <chrono>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/tissue/mesh/check.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/mesh/read.hpp>

namespace wiggers::command {

namespace {

// One geometry: its options come from its quantities.
template <std::size_t N>
void add_shape(CLI::App& verb, const char* name, const char* meaning,
               const std::array<Quantity, N>& quantities,
               TetMesh (*make)(double, const std::array<double, N>&)) {
  struct Options {
    double size_mm = mesh_size_quantity.default_value;
    std::array<double, N> shape;
    std::string output;
  };
  auto o = std::make_shared<Options>();
  o->shape = defaults_of(quantities);
  CLI::App* sub = verb.add_subcommand(name, meaning);
  const auto add = [&](const Quantity& q, double& value) {
    sub->add_option(fmt::format("--{}", q.name), value,
                    fmt::format("{}, {} [{}]", q.meaning, q.unit, to_text(q.default_value)));
  };
  add(mesh_size_quantity, o->size_mm);
  for (std::size_t k = 0; k < N; ++k) add(quantities[k], o->shape[k]);
  sub->add_option("-o,--output", o->output, "mesh file to write, .msh (gmsh, mm)")->required();
  sub->callback([o, name, &quantities, make] {
    check_range(mesh_size_quantity, o->size_mm, name);
    for (std::size_t k = 0; k < N; ++k) check_range(quantities[k], o->shape[k], name);
    require_writable(o->output, "-o", FileKind::mesh);
    const auto start = std::chrono::steady_clock::now();
    const TetMesh mesh = make(o->size_mm, o->shape);
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    fmt::print("{}", report_text(check_mesh(mesh)));
    write_msh(mesh, o->output);
    fmt::print("wrote {} ({:.1f} s)\n", o->output, took.count());
  });
}

void add_mesh_check(CLI::App& verb) {
  struct Options {
    std::string file, unit = "auto";
  };
  auto o = std::make_shared<Options>();
  CLI::App* sub = verb.add_subcommand("check", "Counts, volumes, closed cavities and quality of a mesh file");
  sub->add_option("file", o->file, ".msh (gmsh 2.2, 4.1), .vtk, .vtu, or .pts with .elem (CARP)")->required();
  sub->add_option("--unit", o->unit, "unit of its lengths: auto | m | cm | mm | um [auto]");
  sub->callback([o] {
    if (!std::filesystem::exists(o->file) && !std::filesystem::exists(o->file + ".pts"))
      throw InputError(fmt::format("{}: no such mesh file", o->file));
    std::vector<std::string> notes;
    const TetMesh mesh = read_mesh(o->file, mesh_unit(o->unit), &notes);
    for (const std::string& note : notes) fmt::print("note: {}\n", note);
    fmt::print("{}", report_text(check_mesh(mesh)));
    std::fflush(stdout);
    require_sound(mesh, std::span<const int>(), o->file);
    fmt::print("the mesh can be used\n");
  });
}

}  // namespace

void add_mesh(CLI::App& app) {
  CLI::App* verb = app.add_subcommand("mesh", "Make an idealised geometry, or check a mesh file");
  verb->require_subcommand(1);
  add_shape(*verb, "ellipsoid", "A left ventricle: truncated ellipsoid closed by a cap", ellipsoid_quantities,
            &make_ellipsoid);
  add_shape(*verb, "biventricular", "Both ventricles under a plate with closed valves",
            biventricular_quantities, &make_biventricular);
  add_shape(*verb, "heart", "Four chambers, aorta, pulmonary trunk, closed veins", heart_quantities,
            &make_heart);
  add_mesh_check(*verb);
}

}  // namespace wiggers::command
