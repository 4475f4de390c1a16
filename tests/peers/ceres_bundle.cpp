// Ceres on a BAL file, with the residual that evermap minimises and its analytic Jacobian.
//
//   c++ -O3 -march=native -DNDEBUG ceres_bundle.cpp -o ceres_bundle -I/usr/include/eigen3 -lceres -lglog
//   ceres_bundle FILE.txt THREADS REPEAT dense|sparse|iterative
//
// Prints the fastest of REPEAT runs as JSON.
#include <ceres/ceres.h>
#include <glog/logging.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <string>
#include <vector>

#include "ceres_schur.h"

using Eigen::Matrix3d;
using Eigen::Vector3d;

static Matrix3d Hat(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

class Reprojection : public ceres::SizedCostFunction<2, 9, 3> {
 public:
  Reprojection(double u, double v) : pixel_{u, v} {}

  bool Evaluate(double const* const* x, double* residual, double** jacobians) const override {
    const double* c = x[0];
    const Vector3d angle(c[0], c[1], c[2]), point(x[1][0], x[1][1], x[1][2]);
    const double t2 = angle.squaredNorm(), t = std::sqrt(t2);
    const double a = t2 > 1e-12 ? std::sin(t) / t : 1 - t2 / 6;
    const double b = t2 > 1e-12 ? (1 - std::cos(t)) / t2 : 0.5 - t2 / 24;
    const Vector3d once = angle.cross(point);
    const Vector3d turned = point + a * once + b * angle.cross(once);
    const double near = 1 / (turned.z() + c[5]);
    const double p[2] = {-(turned.x() + c[3]) * near, -(turned.y() + c[4]) * near};
    const double n = p[0] * p[0] + p[1] * p[1], bend = 1 + n * (c[7] + c[8] * n);
    for (int row = 0; row < 2; ++row) residual[row] = c[6] * bend * p[row] - pixel_[row];
    if (!jacobians) return true;
    const double slope = 2 * (c[7] + 2 * c[8] * n);
    Matrix3d rotation, turn;
    if (jacobians[0] || jacobians[1]) {
      const Matrix3d hat = Hat(angle), hat2 = hat * hat;
      const double d = t2 > 1e-6 ? (t - std::sin(t)) / (t2 * t) : 1.0 / 6 - t2 / 120;
      rotation = Matrix3d::Identity() + a * hat + b * hat2;
      turn = Matrix3d::Identity() + b * hat + d * hat2;
    }
    for (int row = 0; row < 2; ++row) {
      double by_p[2] = {c[6] * slope * p[row] * p[0], c[6] * slope * p[row] * p[1]};
      by_p[row] += c[6] * bend;
      const Vector3d by_point = -near * Vector3d(by_p[0], by_p[1], by_p[0] * p[0] + by_p[1] * p[1]);
      if (jacobians[0]) {
        double* j = jacobians[0] + 9 * row;
        Eigen::Map<Vector3d>{j} = turn.transpose() * turned.cross(by_point);
        Eigen::Map<Vector3d>{j + 3} = by_point;
        j[6] = bend * p[row];
        j[7] = c[6] * n * p[row];
        j[8] = c[6] * n * n * p[row];
      }
      if (jacobians[1]) Eigen::Map<Vector3d>{jacobians[1] + 3 * row} = rotation.transpose() * by_point;
    }
    return true;
  }

 private:
  double pixel_[2];
};

int main(int count, char** words) {
  if (count != 5) {
    std::cerr << "ceres_bundle FILE.txt THREADS REPEAT dense|sparse|iterative\n";
    return 2;
  }
  google::InitGoogleLogging(words[0]);
  FLAGS_minloglevel = 3;
  std::ifstream file(words[1]);
  size_t cameras, points, observations;
  file >> cameras >> points >> observations;
  struct Seen {
    size_t camera, point;
    double u, v;
  };
  std::vector<Seen> seen(observations);
  for (auto& s : seen) file >> s.camera >> s.point >> s.u >> s.v;
  std::vector<double> initial(9 * cameras + 3 * points);
  for (double& value : initial) file >> value;

  const std::string solver = words[4];
  return Fastest(std::atoi(words[3]), [&] {
    auto x = initial;
    ceres::Problem problem;
    for (const auto& s : seen)
      problem.AddResidualBlock(new Reprojection(s.u, s.v), nullptr, &x[9 * s.camera], &x[9 * cameras + 3 * s.point]);
    auto* ordering = new ceres::ParameterBlockOrdering;
    for (size_t i = 0; i < points; ++i) ordering->AddElementToGroup(&x[9 * cameras + 3 * i], 0);
    for (size_t i = 0; i < cameras; ++i) ordering->AddElementToGroup(&x[9 * i], 1);
    ceres::Solver::Summary summary;
    ceres::Solve(SchurOptions(solver, std::atoi(words[2]), ordering), &problem, &summary);
    return summary;
  });
}
