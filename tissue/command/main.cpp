// wiggers-3d: the wiggers command with 3D tissue, on one rank or under mpirun. The first rank speaks for all.
#include <unistd.h>

#include <cstdio>
#include <wiggers/tissue/body/register.hpp>
#include <wiggers/tissue/parallel/algebra.hpp>

#include "application.hpp"
#include "verbs.hpp"

namespace {

// Waits a while for the others to fail, too; true if they did.
bool all_ended(MPI_Comm communicator) {
  MPI_Request request;
  MPI_Ibarrier(communicator, &request);
  for (int tries = 0; tries < 300; ++tries) {
    int done = 0;
    MPI_Test(&request, &done, MPI_STATUS_IGNORE);
    if (done) return true;
    usleep(10000);
  }
  return false;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace wiggers;
  const ParallelSession session(&argc, &argv);
  int rank = 0;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  // Errors known to all are said once; one that only this rank met ends all below.
  if (rank > 0 && (!std::freopen("/dev/null", "w", stdout) || !std::freopen("/dev/null", "w", stderr)))
    return 1;
  register_tissue();
  const int status = command::run_application(argc, argv, [](CLI::App& app) {
    command::add_mesh(app);
    command::add_fibres(app);
    command::add_benchmark(app);
  });
  if (!all_ended(MPI_COMM_WORLD)) MPI_Abort(MPI_COMM_WORLD, status == 0 ? 1 : status);
  return status;
}
