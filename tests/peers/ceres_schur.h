// What the programs share that give bundle adjustment to Ceres.
#pragma once
#include <ceres/ceres.h>

#include <chrono>
#include <cstdio>
#include <iostream>
#include <string>

// Points, in group 0 of the ordering, are eliminated first.
inline ceres::Solver::Options SchurOptions(const std::string& solver, int threads,
                                           ceres::ParameterBlockOrdering* ordering) {
  ceres::Solver::Options options;
  options.linear_solver_type = solver == "dense"    ? ceres::DENSE_SCHUR
                               : solver == "sparse" ? ceres::SPARSE_SCHUR
                                                    : ceres::ITERATIVE_SCHUR;
  options.preconditioner_type = solver == "clusters" ? ceres::CLUSTER_JACOBI : ceres::SCHUR_JACOBI;
  options.linear_solver_ordering.reset(ordering);
  options.max_num_iterations = 100;
  options.num_threads = threads;
  options.logging_type = ceres::SILENT;
  return options;
}

// Solves as often as asked, making the problem each time, and prints the fastest as JSON. Gives the program's exit code.
template <class Solve>
int Fastest(int repeat, const Solve& solve) {
  double best = 1e300;
  ceres::Solver::Summary fastest;
  for (int run = 0; run < repeat; ++run) {
    const auto start = std::chrono::steady_clock::now();
    const ceres::Solver::Summary summary = solve();
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (!summary.IsSolutionUsable()) {
      std::cerr << summary.message << '\n';
      return 1;
    }
    if (seconds < best) {
      best = seconds;
      fastest = summary;
    }
  }
  std::printf("{\"initial_cost\": %.17g, \"final_cost\": %.17g, \"iterations\": %d, \"seconds\": %.9f}\n",
              fastest.initial_cost, fastest.final_cost,
              fastest.num_successful_steps + fastest.num_unsuccessful_steps - 1, best);
  return 0;
}
