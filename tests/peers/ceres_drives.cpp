// Ceres on drives, with the residuals that evermap minimises and their analytic Jacobians.
//
//   c++ -O3 -march=native -DNDEBUG ceres_drives.cpp -o ceres_drives -I/usr/include/eigen3 -lceres -lglog
//   ceres_drives FILE.txt THREADS REPEAT dense|sparse|iterative|clusters
//
// FILE.txt is what `solve_bundle --write FILE.txt` wrote: poses, sessions, landmarks, observations, steps of odometry, and
// cameras, counted in its first line. Prints the fastest of REPEAT runs as JSON.
#include <ceres/ceres.h>
#include <ceres/jet.h>
#include <glog/logging.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <string>
#include <vector>

#include "ceres_schur.h"

using Eigen::Map;
using Eigen::Matrix;
using Eigen::Matrix3d;
using Eigen::Quaternion;
using Eigen::Vector3d;
using RowMajor26 = Matrix<double, 2, 6, Eigen::RowMajor>;
using RowMajor23 = Matrix<double, 2, 3, Eigen::RowMajor>;

static const double kHuber = 2.0, kUnseen = 100.0, kScaleSigma = 0.03, kYawSigma = 0.003;

template <typename T>
Quaternion<T> Turn(const Matrix<T, 3, 1>& angle) {
  const T squared = angle.squaredNorm();
  if (squared < T(1e-20)) return Quaternion<T>(T(1), angle[0] / T(2), angle[1] / T(2), angle[2] / T(2)).normalized();
  const T size = sqrt(squared), half = sin(size / T(2)) / size;
  return Quaternion<T>(cos(size / T(2)), half * angle[0], half * angle[1], half * angle[2]);
}

template <typename T>
Matrix<T, 3, 1> Angle(const Quaternion<T>& turn) {
  const T sign = turn.w() < T(0) ? T(-1) : T(1);
  const Matrix<T, 3, 1> axis = sign * turn.vec();
  const T squared = axis.squaredNorm(), w = sign * turn.w();
  if (squared < T(1e-20)) return T(2) / w * axis;
  const T size = sqrt(squared);
  return T(2) * atan2(size, w) / size * axis;
}

// A pose: position, quaternion (x, y, z, w); moved along and about its own axes. Cost functions give their Jacobian by
// that motion, in the first six of seven columns.
class Motion : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* delta, double* y) const override {
    const Eigen::Quaterniond turn(x + 3);
    Map<Vector3d>{y} = Vector3d(x) + turn * Vector3d(delta);
    Map<Eigen::Quaterniond>{y + 3} = (turn * Turn<double>(Vector3d(delta + 3))).normalized();
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Map<Matrix<double, 7, 6, Eigen::RowMajor>>{jacobian}.setIdentity();
    return true;
  }
  bool Minus(const double* y, const double* x, double* delta) const override {
    const Eigen::Quaterniond back = Eigen::Quaterniond(x + 3).conjugate();
    Map<Vector3d>{delta} = back * (Vector3d(y) - Vector3d(x));
    Map<Vector3d>{delta + 3} = Angle<double>(back * Eigen::Quaterniond(y + 3));
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Map<Matrix<double, 6, 7, Eigen::RowMajor>>{jacobian}.setIdentity();
    return true;
  }
};

struct Camera {
  double focal[2], centre[2], k[4];
  Matrix3d rotation;     // camera_from_vehicle
  Vector3d translation;
  double max_theta;
};

// A point through a fisheye (Kannala-Brandt).
class Reprojection : public ceres::SizedCostFunction<2, 7, 3> {
 public:
  Reprojection(const Camera& camera, double u, double v, double sigma) : camera_(camera), pixel_{u, v}, sigma_(sigma) {}

  bool Evaluate(double const* const* x, double* residual, double** jacobians) const override {
    const Matrix3d back = Eigen::Quaterniond(x[0] + 3).conjugate().toRotationMatrix();
    const Vector3d vehicle = back * (Vector3d(x[1]) - Vector3d(x[0]));
    const Vector3d p = camera_.rotation * vehicle + camera_.translation;
    const double across2 = p.x() * p.x() + p.y() * p.y(), across = std::sqrt(across2);
    const double theta = std::atan2(across, p.z());
    if (theta > camera_.max_theta || across < 1e-12) {
      residual[0] = kUnseen, residual[1] = 0;
      if (jacobians && jacobians[0]) std::fill(jacobians[0], jacobians[0] + 14, 0.0);
      if (jacobians && jacobians[1]) std::fill(jacobians[1], jacobians[1] + 6, 0.0);
      return true;
    }
    const double* k = camera_.k;
    const double t2 = theta * theta;
    const double bent = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    const double scale = bent / across;
    for (int row = 0; row < 2; ++row)
      residual[row] = (camera_.focal[row] * scale * p[row] + camera_.centre[row] - pixel_[row]) / sigma_;
    if (!jacobians) return true;
    const double slope = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])));
    const double range2 = across2 + p.z() * p.z();
    // scale's derivative by x and y is `by_across` times them, by z `by_z`.
    const double by_across = (slope * p.z() / range2 - scale) / across2, by_z = -slope / range2;
    RowMajor23 by_p;
    for (int row = 0; row < 2; ++row) {
      by_p.row(row) << by_across * p.x() * p[row], by_across * p.y() * p[row], by_z * p[row];
      by_p(row, row) += scale;
      by_p.row(row) *= camera_.focal[row] / sigma_;
    }
    const RowMajor23 by_vehicle = by_p * camera_.rotation;
    if (jacobians[0]) {
      Map<Matrix<double, 2, 7, Eigen::RowMajor>> j(jacobians[0]);
      j.setZero();
      j.leftCols<3>() = -by_vehicle;
      for (int row = 0; row < 2; ++row) {
        const Vector3d along = by_vehicle.row(row);
        j.block<1, 3>(row, 3) = along.cross(vehicle);
      }
    }
    if (jacobians[1]) Map<RowMajor23>{jacobians[1]} = by_vehicle * back;
    return true;
  }

 private:
  const Camera& camera_;
  double pixel_[2], sigma_;
};

struct Step {
  size_t from, to;
  Vector3d moved;
  Eigen::Quaterniond turned;
  double length, sigma[6];
};

// A step of odometry, corrected by its session's scale and yaw drift.
class Wheels : public ceres::SizedCostFunction<6, 7, 7, 2> {
  using J = ceres::Jet<double, 14>;
  template <typename T> struct Pose {
    Matrix<T, 3, 1> at;
    Quaternion<T> turn;
  };

 public:
  explicit Wheels(const Step& step) : step_(step) {}

  bool Evaluate(double const* const* x, double* residual, double** jacobians) const override {
    Pose<J> poses[2];
    for (int side = 0; side < 2; ++side) {
      const Eigen::Quaterniond turn(x[side] + 3);
      Matrix<J, 3, 1> shift, angle;
      for (int axis = 0; axis < 3; ++axis) {
        shift[axis] = J(0, 6 * side + axis);
        angle[axis] = J(0, 6 * side + 3 + axis);
      }
      poses[side].at = Vector3d(x[side]).cast<J>() + turn.cast<J>() * shift;
      poses[side].turn = turn.cast<J>() * Turn<J>(angle);
    }
    const J scale(x[2][0], 12), yaw(x[2][1], 13);
    const Quaternion<J> back = poses[0].turn.conjugate();
    const Matrix<J, 3, 1> motion = back * (poses[1].at - poses[0].at);
    const auto about = [](const J& angle) { return Turn<J>(Matrix<J, 3, 1>(J(0), J(0), angle)); };
    const J turn = yaw * J(step_.length);
    const Matrix<J, 3, 1> off = motion / scale - about(turn * J(0.5)) * step_.moved.cast<J>();
    const Quaternion<J> measured = step_.turned.cast<J>() * about(turn);
    const Matrix<J, 3, 1> angle = Angle<J>(measured.conjugate() * back * poses[1].turn);
    for (int row = 0; row < 6; ++row) {
      const J one = (row < 3 ? off[row] : angle[row - 3]) / J(step_.sigma[row]);
      residual[row] = one.a;
      if (!jacobians) continue;
      for (int side = 0; side < 2; ++side) {
        if (!jacobians[side]) continue;
        for (int axis = 0; axis < 7; ++axis) jacobians[side][7 * row + axis] = axis < 6 ? one.v[6 * side + axis] : 0;
      }
      if (jacobians[2]) jacobians[2][2 * row] = one.v[12], jacobians[2][2 * row + 1] = one.v[13];
    }
    return true;
  }

 private:
  const Step& step_;
};

// What is known of a session's scale and yaw drift beforehand.
class Prior : public ceres::SizedCostFunction<2, 2> {
 public:
  bool Evaluate(double const* const* x, double* residual, double** jacobians) const override {
    residual[0] = (x[0][0] - 1) / kScaleSigma, residual[1] = x[0][1] / kYawSigma;
    if (jacobians && jacobians[0]) {
      const double j[4] = {1 / kScaleSigma, 0, 0, 1 / kYawSigma};
      std::copy(j, j + 4, jacobians[0]);
    }
    return true;
  }
};

int main(int count, char** words) {
  if (count != 5) {
    std::cerr << "ceres_drives FILE.txt THREADS REPEAT dense|sparse|iterative|clusters\n";
    return 2;
  }
  google::InitGoogleLogging(words[0]);
  FLAGS_minloglevel = 3;
  std::ifstream file(words[1]);
  size_t n_poses, n_sessions, n_landmarks, n_observations, n_steps, n_cameras;
  file >> n_poses >> n_sessions >> n_landmarks >> n_observations >> n_steps >> n_cameras;
  struct Seen {
    size_t pose, camera, landmark;
    double u, v, sigma;
  };
  const auto read = [&](double* values, int many) {
    for (int i = 0; i < many; ++i) file >> values[i];
  };
  std::vector<size_t> session_of(n_poses), fixed(n_poses);
  std::vector<double> first(7 * n_poses + 2 * n_sessions + 3 * n_landmarks);
  for (size_t i = 0; i < n_poses; ++i) {
    file >> session_of[i] >> fixed[i];
    read(&first[7 * i], 7);
  }
  const size_t sessions = 7 * n_poses, landmarks = sessions + 2 * n_sessions;
  for (size_t i = 0; i < n_sessions; ++i) first[sessions + 2 * i] = 1;
  read(&first[landmarks], 3 * n_landmarks);
  std::vector<Seen> seen(n_observations);
  for (auto& s : seen) file >> s.pose >> s.camera >> s.landmark >> s.u >> s.v >> s.sigma;
  std::vector<Step> steps(n_steps);
  for (auto& s : steps) {
    double q[4];
    file >> s.from >> s.to;
    read(s.moved.data(), 3);
    read(q, 4);
    s.turned = Eigen::Quaterniond(q[3], q[0], q[1], q[2]);
    file >> s.length;
    read(s.sigma, 6);
  }
  std::vector<Camera> cameras(n_cameras);
  for (auto& c : cameras) {
    double q[4];
    read(c.focal, 2), read(c.centre, 2), read(c.k, 4), read(c.translation.data(), 3), read(q, 4);
    file >> c.max_theta;
    c.rotation = Eigen::Quaterniond(q[3], q[0], q[1], q[2]).toRotationMatrix();
  }
  if (!file) {
    std::cerr << words[1] << ": expected the file that solve_bundle --write writes\n";
    return 1;
  }

  const std::string solver = words[4];
  return Fastest(std::atoi(words[3]), [&] {
    auto x = first;
    ceres::Problem problem;
    Motion* motion = new Motion;
    for (size_t i = 0; i < n_poses; ++i) {
      problem.AddParameterBlock(&x[7 * i], 7, motion);
      if (fixed[i]) problem.SetParameterBlockConstant(&x[7 * i]);
    }
    ceres::LossFunction* huber = new ceres::HuberLoss(kHuber);
    for (const auto& s : seen)
      problem.AddResidualBlock(new Reprojection(cameras[s.camera], s.u, s.v, s.sigma), huber, &x[7 * s.pose],
                               &x[landmarks + 3 * s.landmark]);
    for (const auto& s : steps)
      problem.AddResidualBlock(new Wheels(s), nullptr, &x[7 * s.from], &x[7 * s.to],
                               &x[sessions + 2 * session_of[s.from]]);
    for (size_t i = 0; i < n_sessions; ++i) problem.AddResidualBlock(new Prior, nullptr, &x[sessions + 2 * i]);
    auto* ordering = new ceres::ParameterBlockOrdering;
    for (size_t i = 0; i < n_landmarks; ++i)
      if (problem.HasParameterBlock(&x[landmarks + 3 * i])) ordering->AddElementToGroup(&x[landmarks + 3 * i], 0);
    for (size_t i = 0; i < n_poses; ++i) ordering->AddElementToGroup(&x[7 * i], 1);
    for (size_t i = 0; i < n_sessions; ++i) ordering->AddElementToGroup(&x[sessions + 2 * i], 1);
    ceres::Solver::Summary summary;
    ceres::Solve(SchurOptions(solver, std::atoi(words[2]), ordering), &problem, &summary);
    return summary;
  });
}
