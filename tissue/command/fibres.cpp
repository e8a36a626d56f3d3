// wiggers fibres: rule-based fibres of a mesh, checked and written for ParaView.
#include <fmt/core.h>
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <memory>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/tissue/body/field_file.hpp>
#include <wiggers/tissue/fibres/fibres.hpp>
#include <wiggers/tissue/mesh/read.hpp>

namespace wiggers::command {

void add_fibres(CLI::App& app);

namespace {

struct Options {
  std::string mesh, output, rule = "bayer", unit = "auto";
  std::array<double, fibre_quantities.size()> angles = defaults_of(fibre_quantities);
};

std::string degrees(double angle) { return std::isnan(angle) ? "-" : fmt::format("{:.1f}", angle); }

void print_checks(const TetMesh& mesh, const FibreField& field, const FibreCheck& check) {
  fmt::print(
      "{} of {} vertices carry a frame; largest error of length {:.1e}, of a right angle {:.1e}, of the "
      "determinant {:.1e}\n",
      check.vertices_with_frame, mesh.points.size(), check.worst_length, check.worst_orthogonality,
      check.worst_handedness);
  const auto table = helix_table(mesh, field);
  if (table.empty()) return;
  fmt::print("\nmean helix angle (deg), away from apex and base\n{:<18} {:>8} {:>8} {:>8}\n", "region",
             "endo", "mid", "epi");
  for (const HelixRow& row : table)
    fmt::print("{:<18} {:>8} {:>8} {:>8}\n", row.region, degrees(row.endo_deg), degrees(row.mid_deg),
               degrees(row.epi_deg));
}

void write_fibres(const std::string& path, const TetMesh& mesh, const FibreField& field) {
  std::array<std::vector<double>, 3> directions;
  for (std::size_t k = 0; k < 3; ++k)
    for (const Frame& frame : field.frames)
      directions[k].insert(directions[k].end(), frame[k].begin(), frame[k].end());
  write_vtu(path, mesh,
            {{"fibre", 3, directions[0]},
             {"sheet", 3, directions[1]},
             {"sheet_normal", 3, directions[2]},
             {"transmural", 1, field.transmural},
             {"endocardial_distance", 1, field.endocardial_distance},
             {"interventricular", 1, field.interventricular},
             {"apex_base", 1, field.apex_base}});
}

void run(const Options& o) {
  // All that can be refused is refused before the work.
  const bool from_file = o.rule == "file";
  if (!from_file && o.rule != "bayer" && o.rule != "doste")
    refuse_unknown("--rule", o.rule, std::vector<std::string>{"bayer", "doste", "file"});
  const FibreRule rule = fibre_rule(from_file ? FibreRuleKind::bayer : fibre_rule_kind(o.rule), o.angles);
  if (std::filesystem::path(o.output).extension() != ".vtu")
    throw InputError(fmt::format("-o: '{}' must end in .vtu, the format ParaView opens", o.output));
  if (!std::filesystem::exists(o.mesh) && !std::filesystem::exists(o.mesh + ".pts"))
    throw InputError(fmt::format("{}: no such mesh file", o.mesh));
  require_writable(o.output, "-o", FileKind::fields);

  std::vector<std::string> notes;
  const TetMesh mesh = read_mesh(o.mesh, mesh_unit(o.unit), &notes);
  for (const std::string& note : notes) fmt::print("{}\n", note);
  if (!from_file && !mesh.cell_frames.empty())
    fmt::print("The mesh brings fibre directions of its own; --rule file keeps them.\n");
  const FibreField field = from_file ? fibres_from_cells(mesh) : rule_based_fibres(mesh, rule);
  const FibreCheck check = check_fibres(mesh, field);
  print_checks(mesh, field, check);
  if (!check.good())
    throw NumericalFailure(fmt::format(
        "the fibres are not sound ({} vertices without a frame); nothing was written. Is the mesh "
        "sound? See `wiggers mesh check`",
        check.vertices_missing));
  write_fibres(o.output, mesh, field);
  fmt::print("\nwritten: {}\n", o.output);
  // Written all the same: the picture shows where.
  if (const AmbiguousTurns turns = ambiguous_turns(mesh, field); turns.cells > 0)
    throw NumericalFailure("fibres: " + turns_text(mesh, turns));
}

}  // namespace

void add_fibres(CLI::App& app) {
  auto o = std::make_shared<Options>();
  CLI::App* verb = app.add_subcommand("fibres", "Fibre, sheet and sheet-normal directions of a mesh by rule");
  verb->add_option("mesh", o->mesh, "mesh file: .msh, .vtk, .vtu, or CARP")->required();
  verb->add_option("-o,--output", o->output, "file for ParaView, .vtu")->required();
  verb->add_option("--rule", o->rule,
                   "bayer, doste (with outflow tracts), or file (directions the mesh brings)")
      ->capture_default_str();
  verb->add_option("--unit", o->unit, "length unit of the mesh file: auto, m, cm, mm, um")
      ->capture_default_str();
  for (std::size_t i = 0; i < fibre_quantities.size(); ++i)
    verb->add_option(fmt::format("--{}", fibre_quantities[i].name), o->angles[i],
                     fmt::format("{} ({})", fibre_quantities[i].meaning, fibre_quantities[i].unit))
        ->capture_default_str();
  verb->callback([o] { run(*o); });
}

}  // namespace wiggers::command
