// A foreign project with the 3D tissue under MPI: a mesh, and the pressure surfaces of a body of it.
#include <cmath>
#include <cstdio>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/verification/benchmarks.hpp>

int main(int argc, char** argv) {
  using namespace wiggers;
  const ParallelSession session(&argc, &argv);
  const double cavity_mL = 1e6 * enclosed_volume(make_sphere(10, 14, 6), mesh_tags::endocardium_LV);
  const benchmarks::BeamResult beam = benchmarks::beam({.bricks = {5, 1, 1}}, MPI_COMM_WORLD);
  std::printf("cavity %.2f mL, tip of the beam at %.2f mm\n", cavity_mL, beam.tip_mm[2]);
  return cavity_mL > 3 && cavity_mL < 4.2 && beam.tip_mm[2] > 3 && beam.tip_mm[2] < 5 ? 0 : 1;
}
