// Ceres on a g2o file, with the residual that GTSAM and evermap minimise and its analytic Jacobians.
//
//   c++ -O3 -march=native -DNDEBUG ceres_pose_graph.cpp -o ceres_pose_graph -lceres -lglog
//   ceres_pose_graph FILE.g2o THREADS REPEAT RADIUS lm|dogleg
//
// Prints the fastest of REPEAT runs as JSON. RADIUS is Ceres' initial trust region.
#include <ceres/ceres.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <vector>

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector2d;
using Eigen::Vector3d;

static Matrix3d Hat(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

// Coefficients of exponentials and Jacobians; series where the closed form is 0/0.
struct Coefficients {
  double one_minus_cos, angle_minus_sin, fourth, fifth, inverse_square;
  explicit Coefficients(double t2) {
    if (t2 < 0.01) {
      one_minus_cos = 0.5 - t2 / 24 + t2 * t2 / 720;
      angle_minus_sin = 1.0 / 6 - t2 / 120 + t2 * t2 / 5040;
      fourth = 1.0 / 24 - t2 / 720 + t2 * t2 / 40320;
      fifth = 1.0 / 120 - t2 / 2520 + t2 * t2 / 120960;
      inverse_square = 1.0 / 12 + t2 / 720 + t2 * t2 / 30240;
      return;
    }
    const double t = std::sqrt(t2), s = std::sin(t), c = std::cos(t);
    one_minus_cos = (1 - c) / t2;
    angle_minus_sin = (t - s) / (t2 * t);
    fourth = (t2 + 2 * c - 2) / (2 * t2 * t2);
    fifth = (2 * t - 3 * s + t * c) / (2 * t2 * t2 * t);
    inverse_square = (1 - 0.5 * t / std::tan(0.5 * t)) / t2;
  }
};

// Rigid motions in space: x y z qx qy qz qw, moved along their own axes by (translation, rotation).
struct Space {
  static constexpr int D = 6, N = 7;
  static constexpr const char* kTag = "SE3:QUAT";
  using Vector = Eigen::Matrix<double, 6, 1>;
  using Matrix = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
  Vector3d t;
  Quaterniond q;

  static Space Read(const double* x) { return {Vector3d(x), Quaterniond(x + 3)}; }
  void Write(double* x) const {
    std::copy_n(t.data(), 3, x);
    std::copy_n(q.coeffs().data(), 4, x + 3);
  }
  static Space FromWords(const double* x) { return {Vector3d(x), Quaterniond(x + 3).normalized()}; }
  Space operator*(const Space& o) const { return {t + q * o.t, q * o.q}; }
  Space Inverse() const {
    const Quaterniond i = q.conjugate();
    return {-(i * t), i};
  }
  static Space Exp(const Vector& xi) {
    const Vector3d phi = xi.tail<3>();
    const Coefficients c(phi.squaredNorm());
    const Matrix3d h = Hat(phi);
    const double half = 0.5 * phi.norm();
    const double k = half < 1e-6 ? 0.5 : 0.5 * std::sin(half) / half;
    Quaterniond q(std::cos(half), k * phi.x(), k * phi.y(), k * phi.z());
    return {xi.head<3>() + c.one_minus_cos * h * xi.head<3>() + c.angle_minus_sin * h * (h * xi.head<3>()),
            q.normalized()};
  }
  static Matrix3d LeftInverse(const Vector3d& phi) {
    const Matrix3d h = Hat(phi);
    return Matrix3d::Identity() - 0.5 * h + Coefficients(phi.squaredNorm()).inverse_square * h * h;
  }
  Vector Log() const {
    const double sign = q.w() < 0 ? -1 : 1;
    const Vector3d v = sign * q.vec();
    const double n = v.norm(), w = sign * q.w();
    const Vector3d phi = n < 1e-9 ? Vector3d(2 / w * v) : Vector3d(2 * std::atan2(n, w) / n * v);
    Vector xi;
    xi << LeftInverse(phi) * t, phi;
    return xi;
  }
  static Matrix LeftJacobianInverse(const Vector& xi) {
    const Vector3d phi = xi.tail<3>();
    const Coefficients c(phi.squaredNorm());
    const Matrix3d r = Hat(xi.head<3>()), p = Hat(phi), pr = p * r, rp = r * p, prp = pr * p;
    const Matrix3d q = 0.5 * r + c.angle_minus_sin * (pr + rp + prp) + c.fourth * (p * pr + rp * p - 3 * prp) +
                       c.fifth * (prp * p + p * prp);
    const Matrix3d j = LeftInverse(phi);
    Matrix m = Matrix::Zero();
    m.block<3, 3>(0, 0) = j;
    m.block<3, 3>(3, 3) = j;
    m.block<3, 3>(0, 3) = -j * q * j;
    return m;
  }
  Matrix Adjoint() const {
    const Matrix3d r = q.toRotationMatrix();
    Matrix m = Matrix::Zero();
    m.block<3, 3>(0, 0) = r;
    m.block<3, 3>(3, 3) = r;
    m.block<3, 3>(0, 3) = Hat(t) * r;
    return m;
  }
};

// Rigid motions of the plane: x y yaw.
struct Plane {
  static constexpr int D = 3, N = 3;
  static constexpr const char* kTag = "SE2";
  using Vector = Eigen::Vector3d;
  using Matrix = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  Vector2d t;
  double yaw;

  static Plane Read(const double* x) { return {Vector2d(x), x[2]}; }
  static Plane FromWords(const double* x) { return Read(x); }
  void Write(double* x) const {
    x[0] = t.x();
    x[1] = t.y();
    x[2] = yaw;
  }
  Matrix2d R() const { return Eigen::Rotation2Dd(yaw).toRotationMatrix(); }
  Plane operator*(const Plane& o) const { return {t + R() * o.t, std::remainder(yaw + o.yaw, 2 * M_PI)}; }
  Plane Inverse() const { return {-(R().transpose() * t), -yaw}; }
  static void Arc(double a, double* s, double* c) {
    const Coefficients k(a * a);
    *s = 1 - a * a * k.angle_minus_sin;
    *c = a * k.one_minus_cos;
  }
  static Plane Exp(const Vector& xi) {
    double s, c;
    Arc(xi.z(), &s, &c);
    return {Vector2d(s * xi.x() - c * xi.y(), c * xi.x() + s * xi.y()), std::remainder(xi.z(), 2 * M_PI)};
  }
  Vector Log() const {
    double s, c;
    Arc(yaw, &s, &c);
    const double n = 1 / (s * s + c * c);
    return {(s * t.x() + c * t.y()) * n, (s * t.y() - c * t.x()) * n, yaw};
  }
  static Matrix LeftJacobianInverse(const Vector& minus_xi) {
    const Vector xi = -minus_xi;  // the right one of -minus_xi
    double s, c;
    Arc(xi.z(), &s, &c);
    const Coefficients k(xi.z() * xi.z());
    const double p = xi.x() * xi.z() * k.angle_minus_sin - xi.y() * k.one_minus_cos;
    const double q = xi.x() * k.one_minus_cos + xi.y() * xi.z() * k.angle_minus_sin;
    const double n = 1 / (s * s + c * c);
    s *= n;
    c *= n;
    Matrix m;
    m << s, -c, c * q - s * p, c, s, -c * p - s * q, 0, 0, 1;
    return m;
  }
  Matrix Adjoint() const {
    Matrix m = Matrix::Identity();
    m.block<2, 2>(0, 0) = R();
    m(0, 2) = t.y();
    m(1, 2) = -t.x();
    return m;
  }
};

template <class G>
class Motion final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return G::N; }
  int TangentSize() const override { return G::D; }
  bool Plus(const double* x, const double* delta, double* moved) const override {
    (G::Read(x) * G::Exp(typename G::Vector(delta))).Write(moved);
    return true;
  }
  // Cost functions give their derivatives by the tangent in the first D columns.
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, G::N, G::D, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }
  bool Minus(const double* y, const double* x, double* delta) const override {
    Eigen::Map<typename G::Vector> d(delta);
    d = (G::Read(x).Inverse() * G::Read(y)).Log();
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, G::D, G::N, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }
};

template <class G>
class Between final : public ceres::SizedCostFunction<G::D, G::N, G::N> {
 public:
  Between(const G& measured, const typename G::Matrix& information)
      : inverse_(measured.Inverse()), adjoint_(inverse_.Adjoint()), root_(information.llt().matrixU()) {}

  bool Evaluate(double const* const* x, double* residuals, double** jacobians) const override {
    const G error = inverse_ * (G::Read(x[0]).Inverse() * G::Read(x[1]));
    const typename G::Vector r = error.Log();
    Eigen::Map<typename G::Vector> weighted(residuals);
    weighted = root_ * r;
    if (jacobians == nullptr) return true;
    if (jacobians[0] != nullptr) Set(jacobians[0], -root_ * G::LeftJacobianInverse(r) * adjoint_);
    if (jacobians[1] != nullptr) Set(jacobians[1], root_ * G::LeftJacobianInverse(-r));
    return true;
  }

 private:
  static void Set(double* to, const typename G::Matrix& jacobian) {
    Eigen::Map<Eigen::Matrix<double, G::D, G::N, Eigen::RowMajor>> all(to);
    all.setZero();
    all.template leftCols<G::D>() = jacobian;
  }
  G inverse_;
  typename G::Matrix adjoint_, root_;
};

template <class G>
struct Edge {
  long from, to;
  G measured;
  typename G::Matrix information;
};

template <class G>
int Solve(std::istream& file, int threads, int repeat, double radius, bool dogleg) {
  std::map<long, std::array<double, G::N>> initial;
  std::vector<Edge<G>> edges;
  std::string line;
  while (std::getline(file, line)) {
    std::istringstream words(line);
    std::string tag;
    words >> tag;
    double x[G::N];
    if (tag == std::string("VERTEX_") + G::kTag) {
      long id;
      words >> id;
      for (double& value : x) words >> value;
      G::FromWords(x).Write(initial[id].data());
    } else if (tag == std::string("EDGE_") + G::kTag) {
      Edge<G> edge;
      words >> edge.from >> edge.to;
      for (double& value : x) words >> value;
      edge.measured = G::FromWords(x);
      for (int i = 0; i < G::D; ++i)
        for (int j = i; j < G::D; ++j) {
          words >> edge.information(i, j);
          edge.information(j, i) = edge.information(i, j);
        }
      edges.push_back(edge);
    }
  }

  double best = 1e300;
  ceres::Solver::Summary summary;
  for (int run = 0; run < repeat; ++run) {
    auto poses = initial;
    Motion<G> manifold;
    ceres::Problem::Options keep;
    keep.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ceres::Problem problem(keep);
    for (const auto& edge : edges)
      problem.AddResidualBlock(new Between<G>(edge.measured, edge.information), nullptr, poses[edge.from].data(),
                               poses[edge.to].data());
    for (auto& pose : poses) problem.SetManifold(pose.second.data(), &manifold);
    problem.SetParameterBlockConstant(poses.begin()->second.data());
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
    options.max_num_iterations = 200;
    options.num_threads = threads;
    options.initial_trust_region_radius = radius;
    options.max_trust_region_radius = 1e32;
    if (dogleg) options.trust_region_strategy_type = ceres::DOGLEG;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary one;
    const auto start = std::chrono::steady_clock::now();
    ceres::Solve(options, &problem, &one);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (seconds < best) {
      best = seconds;
      summary = one;
    }
  }
  std::printf("{\"initial_cost\": %.17g, \"final_cost\": %.17g, \"iterations\": %d, \"seconds\": %.9f}\n",
              summary.initial_cost, summary.final_cost,
              summary.num_successful_steps + summary.num_unsuccessful_steps - 1, best);
  return 0;
}

int main(int count, char** words) {
  if (count != 6) {
    std::cerr << "ceres_pose_graph FILE.g2o THREADS REPEAT RADIUS lm|dogleg\n";
    return 2;
  }
  google::InitGoogleLogging(words[0]);
  FLAGS_minloglevel = 3;
  std::ifstream file(words[1]);
  std::stringstream text;
  text << file.rdbuf();
  const int threads = std::atoi(words[2]), repeat = std::atoi(words[3]);
  const double radius = std::atof(words[4]);
  const bool dogleg = std::string(words[5]) == "dogleg";
  return text.str().find("SE3:QUAT") != std::string::npos ? Solve<Space>(text, threads, repeat, radius, dogleg)
                                                          : Solve<Plane>(text, threads, repeat, radius, dogleg);
}
