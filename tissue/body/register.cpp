#include <wiggers/heart/scene/tissue_services.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>
#include <wiggers/tissue/body/body_run.hpp>
#include <wiggers/tissue/body/plan.hpp>
#include <wiggers/tissue/body/register.hpp>
#include <wiggers/tissue/body/tissue_wall.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/verification/self_check.hpp>

namespace wiggers {

void register_tissue() {
  register_wall_kind(tissue_wall_kind());
  TissueServices& services = tissue_services();
  services.run_body = [](const Scene& scene, const BodyRequest& request) {
    return scene.physics == Physics::mechanics ? run_body_mechanics(scene, request, MPI_COMM_WORLD)
                                               : run_body_electrophysiology(scene, request, MPI_COMM_WORLD);
  };
  services.check = check_tissue;
  services.on_first_rank = [](const std::function<void()>& work) {
    collectively(MPI_COMM_WORLD, [&] {
      int rank = 0;
      MPI_Comm_rank(MPI_COMM_WORLD, &rank);
      if (rank == 0) work();
    });
  };
  services.any_rank = [](bool value) {
    int mine = value, any = 0;
    MPI_Allreduce(&mine, &any, 1, MPI_INT, MPI_MAX, MPI_COMM_WORLD);
    return any != 0;
  };
}

}  // namespace wiggers
