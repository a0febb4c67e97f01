// Ceres on a BAL problem, with the settings and the JSON of `tractrix bal`, for comparison.
//
//   apt-get install libceres-dev libeigen3-dev g++
//   g++ -O3 -std=c++17 -o ceres_bal ceres_bal.cc -I/usr/include/eigen3 -lceres -lglog
//   ./ceres_bal PROBLEM [dense|sparse|iterative] [THREADS]

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <string>
#include <vector>

namespace {

// The residual of the format: a camera looks down its negative z axis.
struct Reprojection {
  double x, y;

  template <typename T>
  bool operator()(const T* camera, const T* point, T* residual) const {
    T p[3];
    ceres::AngleAxisRotatePoint(camera, point, p);
    for (int k = 0; k < 3; ++k) p[k] += camera[3 + k];
    const T u = -p[0] / p[2], v = -p[1] / p[2];
    const T r2 = u * u + v * v;
    const T scale = camera[6] * (1.0 + r2 * (camera[7] + r2 * camera[8]));
    residual[0] = scale * u - x;
    residual[1] = scale * v - y;
    return true;
  }
};

double CpuSeconds() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

double WallSeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: %s PROBLEM [dense|sparse|iterative] [THREADS]\n", argv[0]);
    return 2;
  }
  std::ifstream file(argv[1]);
  int num_cameras = 0, num_points = 0, num_observations = 0;
  file >> num_cameras >> num_points >> num_observations;
  std::vector<int> camera(num_observations), point(num_observations);
  std::vector<double> x(num_observations), y(num_observations), values(9 * num_cameras + 3 * num_points);
  for (int i = 0; i < num_observations; ++i) file >> camera[i] >> point[i] >> x[i] >> y[i];
  for (double& value : values) file >> value;
  if (!file) {
    std::fprintf(stderr, "%s: cut or not a BAL problem\n", argv[1]);
    return 1;
  }

  double* points = values.data() + 9 * num_cameras;
  ceres::Problem problem;
  for (int i = 0; i < num_observations; ++i) {
    auto* cost = new ceres::AutoDiffCostFunction<Reprojection, 2, 9, 3>(new Reprojection{x[i], y[i]});
    problem.AddResidualBlock(cost, nullptr, &values[9 * camera[i]], points + 3 * point[i]);
  }
  const std::string solver = argc > 2 ? argv[2] : "dense";
  ceres::Solver::Options options;
  options.max_num_iterations = 50;
  options.num_threads = argc > 3 ? std::atoi(argv[3]) : 1;
  options.linear_solver_type = solver == "dense"    ? ceres::DENSE_SCHUR
                               : solver == "sparse" ? ceres::SPARSE_SCHUR
                                                    : ceres::ITERATIVE_SCHUR;
  auto* ordering = new ceres::ParameterBlockOrdering;
  for (int i = 0; i < num_points; ++i) ordering->AddElementToGroup(points + 3 * i, 0);
  for (int i = 0; i < num_cameras; ++i) ordering->AddElementToGroup(&values[9 * i], 1);
  options.linear_solver_ordering.reset(ordering);

  const double cpu = CpuSeconds(), wall = WallSeconds();
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  std::printf(
      "{\"initial_cost\": %.6f, \"final_cost\": %.6f, \"iterations\": %d, \"solve_cpu_s\": %.4f, \"solve_wall_s\": %.4f}\n",
      summary.initial_cost, summary.final_cost, int(summary.iterations.size()) - 1, CpuSeconds() - cpu,
      WallSeconds() - wall);
  return 0;
}
