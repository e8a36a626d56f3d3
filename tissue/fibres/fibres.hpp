// Rule-based fibres: a right-handed frame (fibre, sheet, sheet-normal) at each vertex of the myocardium, and
// the normalised coordinates of the wall that the tissue needs besides.
//
// Sources: Bayer, Blake, Plank, Trayanova, Ann. Biomed. Eng. 40 (2012) 2243; Doste et al., Int. J. Numer.
// Meth. Biomed. Eng. 35 (2019) e3185; Piersanti et al., CMAME 373 (2021) 113468 and PhD thesis (2021), ch. 4.
//
// Both ventricular rules stand on the harmonic fields phi_left and phi_right (1 on one ventricle's
// endocardium, 0 on the other's and on the epicardium; phi_epi = 1 - phi_left - phi_right) and on a
// longitudinal field psi (0 at the apex, 1 at the base). With e_t the transmural direction *from the
// endocardium to the outside*,
//
//   e_n = grad psi made orthogonal to e_t,   e_l = e_n x e_t        (longitudinal, circumferential)
//   f = e_l cos(alpha) + e_n sin(alpha)                             (turned about e_t by alpha)
//   s = e_t cos(beta) + (e_n cos(alpha) - e_l sin(alpha)) sin(beta) (turned about f by beta)
//   n = f x s
//
// Decided here:
// * e_t points outwards, although phi is 1 on the endocardium. With e_t along grad phi a positive alpha would
//   be a left-handed helix; hearts have a right-handed one on the endocardium, which is what alpha_endo > 0
//   means.
// * Angles are linear in phi everywhere. In the frame of the left ventricle
//     alpha = phi_left alpha_endo(left) - phi_right alpha_endo(right) + phi_epi alpha_epi,
//   and with left and right exchanged in the frame of the right one; the minus sign because e_t turns round
//   in the septum. On free walls this is alpha_epi (1 - d) + alpha_endo d with d = phi; it has no jump, and
//   it removes the bend (an angle quadratic in depth) of the published rule of Bayer et al. beta likewise.
// * "bayer": the frames of left, right and outer wall are blended as rotations (spherical interpolation of
// unit
//   quaternions, nearest of the four equivalent frames), by phi_right / (phi_left + phi_right), then phi_epi.
// * "doste": transmural field Phi = 2 phi_left - phi_right; its sign tells the ventricle, so that the septum
//   belongs to two thirds to the left. Longitudinal fields run from each ventricle's apex to its inflow ring
//   and to its outflow ring and are blended with w (1 at the inflow ring and in the lower half of the
//   ventricles, 0 at the outflow ring); angles blend with w towards those of the outflow tract. Inside the
//   septum alpha passes through 0 where Phi = 0, which keeps fibres continuous; elsewhere alpha_epi blends
//   between the ventricles with xi_hat. Rings are told apart by what is near: great artery (volume 7 or 8) or
//   atrium. A mesh without arteries has no outflow tracts: the rule then uses apex to base alone.
// * Atria: psi is chosen per bundle as in Piersanti et al. (vestibule, veins, remaining wall) where the vein
//   rings can be told apart, otherwise annulus to roof alone. Simplified: crista terminalis, pectinate
//   muscles, intercaval and Bachmann's bundle are not told apart, appendages are not detected.
//
// Sets of vertices: only facets that belong to a myocardial cell count (the tagged endocardia also cover
// valve discs and caps). Base = vertices shared with non-conductive cells; in a truncated ventricle (no
// annuli) the cut instead, surfaces 32 and 40, where it is tagged. Epicardium = 31, and 32 where it is not
// the base. Apex = epicardial vertex farthest below the base.
//
// The whole mesh is treated by every process: no frame depends on the number of processes.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/core/quantity.hpp>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

struct FibreAngles {
  double alpha_endo, alpha_epi, beta_endo, beta_epi;  // degrees
};

enum class FibreRuleKind { bayer, doste };

// Defaults: angles used with whole hearts by the group of Piersanti et al., for both rules. Bayer et al. give
// alpha +40 / -50 and beta -65 / +25.
inline constexpr std::array<Quantity, 16> fibre_quantities = {{
    {"left-alpha-endo", "deg", 60, -90, 90, "helix angle, left ventricle, inside"},
    {"left-alpha-epi", "deg", -60, -90, 90, "helix angle, left ventricle, outside"},
    {"left-beta-endo", "deg", -20, -90, 90, "sheet angle, left ventricle, inside"},
    {"left-beta-epi", "deg", 20, -90, 90, "sheet angle, left ventricle, outside"},
    {"right-alpha-endo", "deg", 90, -90, 90, "helix angle, right ventricle, inside"},
    {"right-alpha-epi", "deg", -25, -90, 90, "helix angle, right ventricle, outside"},
    {"right-beta-endo", "deg", -20, -90, 90, "sheet angle, right ventricle, inside"},
    {"right-beta-epi", "deg", 20, -90, 90, "sheet angle, right ventricle, outside"},
    {"left-outflow-alpha-endo", "deg", 0, -90, 90, "helix angle, left outflow tract, inside (doste)"},
    {"left-outflow-alpha-epi", "deg", 0, -90, 90, "helix angle, left outflow tract, outside (doste)"},
    {"left-outflow-beta-endo", "deg", 0, -90, 90, "sheet angle, left outflow tract, inside (doste)"},
    {"left-outflow-beta-epi", "deg", 0, -90, 90, "sheet angle, left outflow tract, outside (doste)"},
    {"right-outflow-alpha-endo", "deg", 90, -90, 90, "helix angle, right outflow tract, inside (doste)"},
    {"right-outflow-alpha-epi", "deg", 0, -90, 90, "helix angle, right outflow tract, outside (doste)"},
    {"right-outflow-beta-endo", "deg", 0, -90, 90, "sheet angle, right outflow tract, inside (doste)"},
    {"right-outflow-beta-epi", "deg", 0, -90, 90, "sheet angle, right outflow tract, outside (doste)"},
}};
static_assert(well_formed(fibre_quantities));

struct FibreRule {
  FibreRuleKind kind;
  FibreAngles left, right, left_outflow, right_outflow;
};

// `angles` in the order of fibre_quantities; refuses angles out of range.
FibreRule fibre_rule(FibreRuleKind kind = FibreRuleKind::bayer,
                     const std::array<double, 16>& angles = defaults_of(fibre_quantities));
// "bayer" or "doste"; refuses another name.
FibreRuleKind fibre_rule_kind(std::string_view name);

using Frame = std::array<Point3, 3>;  // f, s, n

// The rule's two turns: f, s, n from the wall's axes e_l, e_n, e_t.
Frame turned_frame(const Frame& axes, double alpha_deg, double beta_deg);

// One entry a vertex of the mesh in each list.
struct FibreField {
  std::vector<Frame> frames;  // zero vectors outside the myocardium
  std::vector<Frame> axes;    // e_l, e_n, e_t of the wall
  // The angles by which the rule turned the frames out of the axes. Empty where frames are lines of which no
  // angle is known.
  std::vector<double> alpha_deg, beta_deg;
  std::vector<double> transmural;            // 1 endocardium .. 0 epicardium of the chamber; 0 outside
  std::vector<double> endocardial_distance;  // 0 on either ventricular endocardium .. 1 outside; 1 in atria
  std::vector<double> interventricular;      // xi_hat: 0 right .. 1 left; 1 for a lone left ventricle, atria
  std::vector<double> apex_base;  // psi: 0 apex .. 1 base; atria: 0 roof .. 1 annulus. Harmonic, and
                                  // 0 at one vertex only: near 1 in most of the wall, not a length
  // Frames of the cells, where a file brought them (fibres_from_cells): frame_at then gives these.
  std::vector<Frame> cell_frames;
};

FibreField rule_based_fibres(const TetMesh& mesh, const FibreRule& rule = fibre_rule());

// Frames a mesh file brought (TetMesh::cell_frames), made orthonormal; those of vertices are the main
// directions of the surrounding cells, for output. The coordinates of the wall are computed as above.
FibreField fibres_from_cells(const TetMesh& mesh);

// The frame at a point of a cell, given by its four barycentric coordinates. Between vertices the wall's axes
// are interpolated, as rotations, and the angles, as numbers, and the frame is turned out of them there: a
// cell may span a whole wall, from +90 to -90 degrees, and has circumferential fibres in its middle. (An
// average of the fibres as lines goes the shorter way round, which is the wrong one as soon as a cell spans
// more than 90 degrees.) Axes have no sign: of the four that have the same lines, those nearest to the axes
// of one vertex of the cell are taken. Orthonormal, continuous in the cell. Where no angles are known, the
// frames themselves are interpolated as rotations. Zero vectors in a non-conductive cell.
Frame frame_at(const FibreField& field, const TetMesh& mesh, int cell,
               const std::array<double, 4>& barycentric);

// Angle (degrees, in (-90, 90]) of a fibre to the circumferential direction in the plane of the wall.
// `outward` is the transmural direction, `axis` points from the apex to the base; positive angles are
// right-handed helices.
double helix_angle_deg(const Point3& fibre, const Point3& outward, const Point3& axis);

struct FibreCheck {
  std::size_t vertices_with_frame = 0;   // of these,
  double worst_length = 0;               // largest | |v| - 1 |
  double worst_orthogonality = 0;        // largest |cosine| between two directions
  double worst_handedness = 0;           // largest |det [f s n] - 1|
  std::size_t vertices_missing = 0;      // myocardial vertices without a frame
  std::size_t vertices_superfluous = 0;  // others with one
  bool sizes_match = false;              // every list has one entry a vertex
  bool coordinates_in_range = false;     // all scalar fields in [0, 1]
  static constexpr double tolerance = 1e-10;
  bool good() const;
};
FibreCheck check_fibres(const TetMesh& mesh, const FibreField& field);

// Fibres of a file are lines. Where they turn through the wall by 60 degrees or more from one cell to its
// neighbour, the other way round is 120 degrees or less, and nothing tells which of the two it is: their
// average at a vertex, half-way, may lie at a right angle to the tissue's fibres.
struct AmbiguousTurns {
  std::size_t cells = 0;  // that have such a neighbour
  int first = -1;
  static constexpr double from_deg = 60;
};
AmbiguousTurns ambiguous_turns(const TetMesh& mesh, const FibreField& field);
// What to say of them: how many, where, what to do.
std::string turns_text(const TetMesh& mesh, const AmbiguousTurns& turns);

// Mean helix angles away from apex and base (between 20 and 80 % of the height of the myocardium).
struct HelixRow {
  std::string region;
  double endo_deg, mid_deg, epi_deg;  // transmural >= 0.9, 0.4 .. 0.6, <= 0.1; NaN where there is no vertex;
                                      // in (-88, 92]: a mean near 90 is not shown as one near -90
  std::array<std::size_t, 3> vertices;
};
std::vector<HelixRow> helix_table(const TetMesh& mesh, const FibreField& field);

}  // namespace wiggers
