// What a scene says of a wall of 3D tissue, and how it is read.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>
#include <wiggers/heart/scene/scene.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>
#include <wiggers/tissue/mesh/sites.hpp>
#include <wiggers/tissue/physics/mechanics.hpp>
#include <wiggers/tissue/physics/monodomain.hpp>

namespace wiggers {

namespace tissue_keys {
inline constexpr Quantity size{"size_mm", "mm", 4, 0.3, 20, "edge length of the tetrahedra of a made mesh"};
inline constexpr Quantity order{"order", "1", 1, 1, 2, "polynomial order of the finite elements"};
inline constexpr Quantity ep_order{"order", "1", 2, 1, 2, "polynomial order of the potential"};
inline constexpr Quantity tau{"tau_ms", "ms", 0.05, 1e-3, 0.5, "step of electrophysiology"};
inline constexpr Quantity ep_tolerance{"relative_tolerance",
                                       "1",
                                       1e-8,
                                       1e-12,
                                       1e-2,
                                       "linear solver of the potential: residual over right-hand side"};
inline constexpr Quantity table_spacing{
    "table_spacing_mV", "mV", 0.1, 0, 1, "tables of the ionic models' functions of potential; 0: none"};
inline constexpr Quantity fast_thickness{
    "fast_layer", "1", 0.05, 0, 1, "thickness of the fast endocardial layer, share of the wall; 0: none"};
inline constexpr Quantity sigma_f{
    "fibre_mm2_per_ms", "mm^2/ms", 0.2, 0, 10, "conductivity along the fibre over chi C_m"};
inline constexpr Quantity sigma_s{
    "sheet_mm2_per_ms", "mm^2/ms", 0.11, 0, 10, "conductivity along the sheet over chi C_m"};
inline constexpr Quantity sigma_n{
    "normal_mm2_per_ms", "mm^2/ms", 0.055, 0, 10, "conductivity along the normal over chi C_m"};
inline constexpr Quantity x{"x_mm", "mm", 0, -1e3, 1e3, "place"};
inline constexpr Quantity y{"y_mm", "mm", 0, -1e3, 1e3, "place"};
inline constexpr Quantity z{"z_mm", "mm", 0, -1e3, 1e3, "place"};
inline constexpr Quantity height{
    "height", "1", 0.5, 0, 1, "of a site on a ventricle's wall: 0 at the apex, 1 at the base"};
inline constexpr Quantity radius{"radius_mm", "mm", 3, 0.01, 1e3, "radius of the stimulated ball"};
inline constexpr Quantity start{"start_ms", "ms", 160, 0, 20000, "start of the stimulus in the beat"};
inline constexpr Quantity duration{"duration_ms", "ms", 3, 0.01, 100, "length of the stimulus"};
inline constexpr Quantity amplitude{"amplitude_V_per_s", "V/s", 25.71, 0, 1e4, "stimulus current over C_m"};
inline constexpr Quantity density{"density_kg_per_m3", "kg/m^3", 1e3, 0, 2e3, "mass density of the tissue"};
inline constexpr Quantity newton{
    "residual_tolerance", "1", 1e-5, 1e-12, 1e-1, "Newton: residual over that of the step's first guess"};
inline constexpr Quantity linear{
    "linear_tolerance", "1", 1e-3, 1e-12, 0.5, "linear solver of mechanics: residual over right-hand side"};
inline constexpr Quantity lag{
    "tangent_every",
    "1",
    1,
    1,
    1000,
    "steps for which tangent and preconditioner are kept while Newton converges well"};
inline constexpr Quantity normal_stiffness{"normal_stiffness_Pa_per_m", "Pa/m", 0, 0, 1e9,
                                           "spring along the normal"};
inline constexpr Quantity normal_damping{"normal_damping_Pa_s_per_m", "Pa s/m", 0, 0, 1e8,
                                         "dashpot along the normal"};
inline constexpr Quantity full_stiffness{"full_stiffness_Pa_per_m", "Pa/m", 0, 0, 1e9,
                                         "spring in all directions"};
inline constexpr Quantity full_damping{"full_damping_Pa_s_per_m",  "Pa s/m", 0, 0, 1e8,
                                       "dashpot in all directions"};
// In the order of the chambers; the founding paper's loads for recovery (1200, 1150, 900 and 650 Pa).
inline constexpr std::array<Quantity, n_chambers> image_pressures = {{
    {"image_pressure_LA_mmHg", "mmHg", 9.0, 0, 100,
     "pressure in the left atrium when the mesh's shape was taken"},
    {"image_pressure_LV_mmHg", "mmHg", 8.6, 0, 100,
     "pressure in the left ventricle when the mesh's shape was taken"},
    {"image_pressure_RA_mmHg", "mmHg", 6.75, 0, 100,
     "pressure in the right atrium when the mesh's shape was taken"},
    {"image_pressure_RV_mmHg", "mmHg", 4.9, 0, 100,
     "pressure in the right ventricle when the mesh's shape was taken"},
}};
// The founding paper's 9500 and 1700 Pa.
inline constexpr std::array<Quantity, 2> artery_image_pressures = {{
    {"image_pressure_AO_mmHg", "mmHg", 71.3, 0, 300, "pressure in the aorta when the mesh's shape was taken"},
    {"image_pressure_PT_mmHg", "mmHg", 12.8, 0, 300,
     "pressure in the pulmonary trunk when the mesh's shape was taken"},
}};
inline constexpr Quantity pressure{"pressure_mmHg", "mmHg", 0, -100, 1000, "pressure at the whole load"};
inline constexpr Quantity volume{"volume_mL", "mL", 100, 0.01, 1e4, "volume at the whole load"};
inline constexpr Quantity tension{
    "active_tension_kPa", "kPa", 0, 0, 1000, "active tension of the myocardium at the whole load"};
inline constexpr Quantity n_s{"n_s", "1", 0, 0, 1, "share of active stress along the sheet"};
inline constexpr Quantity right_share{
    "right_share", "1", 0.7, 0, 10, "active tension of the right ventricle over that of the left"};
inline constexpr Quantity fields_every{
    "fields_every_ms", "ms", 10, 0, 1e6, "time between fields written for ParaView; 0: none"};
}  // namespace tissue_keys

// Arteries that a body of tissue may have: their inner surface carries the circulation's pressure.
struct Artery {
  std::string_view name;
  int tag;
};
inline constexpr std::array<Artery, 2> arteries = {
    {{"AO", mesh_tags::endothelium_aorta}, {"PT", mesh_tags::endothelium_pulmonary_trunk}}};

// Of mechanics alone: a cavity's pressure, or its volume where one is given, at the whole load.
struct CavityLoad {
  double pressure_mmHg = 0;
  std::optional<double> volume_mL;
};

struct TissuePlan {
  std::string mesh_file;  // empty: made
  std::string shape;      // ellipsoid | biventricular | heart
  std::vector<double> shape_values;
  double size_mm = 4;
  std::string mesh_unit = "auto";
  FibreRule fibres{};
  bool fibres_from_file = false;

  MonodomainSettings electrophysiology;
  Conductivity conductivity, fast_conductivity, atrial_conductivity;
  bool feedback = true;  // deformed conductivities
  std::vector<Stimulus> stimuli;
  std::vector<std::optional<Site>> sites;  // of each stimulus: where it is, if not at its centre
  std::vector<Point3> electrodes;

  MechanicsSettings mechanics;       // without its surfaces
  std::optional<SolverKind> solver;  // none: by what the body is
  double residual_tolerance = 1e-5, linear_tolerance = 1e-3;
  int tangent_every = 1;
  std::vector<int> named_tags;  // of materials and supports that the scene names itself
  bool recover_reference = true;
  std::array<double, n_chambers> image_pressure_mmHg{};
  std::array<double, arteries.size()> artery_image_pressure_mmHg{};

  // Mechanics alone.
  std::array<CavityLoad, n_chambers> loads{};
  std::array<double, arteries.size()> arterial_pressure_mmHg{};
  double active_tension_kPa = 0;
  bool fields_every_step = true;

  double right_share = 0.7;
  double fields_every_ms = 10;
};

// A wall or body of tissue as its table describes it.
class TissueRecipe final : public WallRecipe {
 public:
  explicit TissueRecipe(TissuePlan plan) : plan_(std::move(plan)) {}
  const TissuePlan& plan() const { return plan_; }
  std::unique_ptr<Wall> make(const WallPlan& plan, const WallSiteOf<double>& site,
                             std::span<const double> values) const override;
  std::optional<double> activation_s(const WallPlan& plan, int chamber, double period_s) const override;
  bool in_space() const override { return true; }

 private:
  TissuePlan plan_;
};
const TissuePlan& tissue_plan(const WallPlan& wall);  // of a wall of this kind

// Reads a wall's or body's table, what its physics needs; of a body also its cavities.
WallKind tissue_wall_kind();

// Where linear tetrahedra meet a bulk modulus at which they lock: what to do; else empty.
std::string locking_warning(const MechanicsSettings& mechanics);
// The part of the table on mechanics; adds cavities that only the loads name.
void read_mechanics(SettingsReader& table, Physics physics, std::vector<int>& chambers, TissuePlan& plan);

}  // namespace wiggers
