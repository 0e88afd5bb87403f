// What Gazebo's own reader of SDF makes of a file: its errors, or the world as JSON, every pose in the world's frame.
#include <iomanip>
#include <iostream>
#include <sdf/sdf.hh>

static void numbers(const char* name, std::initializer_list<double> values) {
  std::cout << "\"" << name << "\": [";
  const char* comma = "";
  for (double value : values) std::cout << comma << value, comma = ", ";
  std::cout << "], ";
}

static void pose(const char* name, const ignition::math::Pose3d& p) {
  numbers(name, {p.Pos().X(), p.Pos().Y(), p.Pos().Z(), p.Rot().W(), p.Rot().X(), p.Rot().Y(), p.Rot().Z()});
}

static std::string mesh(const sdf::Geometry* geometry) {
  return geometry->MeshShape() ? geometry->MeshShape()->Uri() : "";
}

int main(int, char** arguments) {
  sdf::Root root;
  const auto errors = root.Load(arguments[1]);
  for (const auto& error : errors) std::cerr << error.Message() << "\n";
  if (!errors.empty() || root.WorldCount() != 1) return 1;
  const sdf::World* world = root.WorldByIndex(0);
  const auto gravity = world->Gravity();
  std::cout << std::setprecision(17) << "{\"name\": \"" << world->Name() << "\", ";
  numbers("gravity", {gravity.X(), gravity.Y(), gravity.Z()});
  numbers("step", {world->PhysicsDefault()->MaxStepSize()});
  numbers("lights", {double(world->LightCount())});
  std::cout << "\"models\": [";
  for (uint64_t i = 0; i < world->ModelCount(); ++i) {
    const sdf::Model* model = world->ModelByIndex(i);
    if (model->LinkCount() != 1) return 2;
    const sdf::Link* link = model->LinkByIndex(0);
    ignition::math::Pose3d place;
    if (!model->SemanticPose().Resolve(place).empty()) return 3;
    const auto inertial = link->Inertial();
    const auto moments = inertial.Moi();
    std::cout << (i ? ", " : "") << "{\"name\": \"" << model->Name() << "\", \"static\": " << (model->Static() ? "true" : "false") << ", ";
    pose("pose", place);
    pose("center", inertial.Pose());
    numbers("mass", {inertial.MassMatrix().Mass()});
    numbers("moments", {moments(0, 0), moments(0, 1), moments(0, 2), moments(1, 1), moments(1, 2), moments(2, 2)});
    std::cout << "\"visuals\": [";
    for (uint64_t k = 0; k < link->VisualCount(); ++k) {
      std::cout << (k ? ", " : "") << "\"" << mesh(link->VisualByIndex(k)->Geom()) << "\"";
    }
    std::cout << "], \"collisions\": [";
    for (uint64_t k = 0; k < link->CollisionCount(); ++k) {
      const auto* collision = link->CollisionByIndex(k);
      const auto rubs = collision->Element()->GetElement("surface")->GetElement("friction")->GetElement("ode");
      std::cout << (k ? ", " : "") << "[\"" << mesh(collision->Geom()) << "\", " << rubs->Get<double>("mu") << ", " << rubs->Get<double>("mu2") << "]";
    }
    std::cout << "]}";
  }
  std::cout << "]}\n";
  return 0;
}
