// Navmeshes as habitat-sim bakes and searches them, on Recast and Detour, behind a C interface.
//
// Order of steps, constants and rules follow habitat-sim's PathFinder, so that files are the same bytes and distances the
// same numbers. Points are in the glTF frame [m], +Y up. The language-neutral part (choice of islands, random points,
// trajectories) is the caller's. A mesh belongs to one thread at a time.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include <recastnavigation/DetourNavMesh.h>
#include <recastnavigation/DetourNavMeshBuilder.h>
#include <recastnavigation/DetourNavMeshQuery.h>
#include <recastnavigation/Recast.h>

namespace {

constexpr int kMagic = 'M' << 24 | 'S' << 16 | 'E' << 8 | 'T';
constexpr int kVersion = 2;
constexpr int kLongest = 256;                     // polygons of a corridor, and corners of a path
constexpr int kSearchNodes = 2048;
constexpr float kSnapHalfExtents[3] = {2, 4, 2};  // box around a point that its polygon is looked for in
constexpr float kNoArea = 1e-5f;                  // polygons smaller than this [m2] are closed to agents
constexpr unsigned short kWalkable = 1, kDisabled = 4;
constexpr double kInfinite = std::numeric_limits<double>::infinity();

enum Status { kDone = 0, kFailed = 1, kEmpty = 2 };

// The settings of a .navmesh header, as they lie there.
struct Settings {
  float cell_size, cell_height, agent_height, agent_radius, agent_max_climb, agent_max_slope, region_min_size,
      region_merge_size, edge_max_length, edge_max_error, vertices_per_polygon, detail_sample_distance,
      detail_sample_max_error;
  unsigned char low_hanging_obstacles, ledge_spans, low_height_spans, static_objects;
};
static_assert(sizeof(Settings) == 56, "13 numbers and 4 truth values");

struct FileHeader {
  int magic, version, tiles;
  dtNavMeshParams parameters;
};

struct TileHeader {
  dtTileRef reference;
  int size;
};
static_assert(sizeof(FileHeader) == 40 && sizeof(TileHeader) == 8, "layout of the file");

template <typename T, void (*Free)(T*)>
struct Freed {
  void operator()(T* object) const { Free(object); }
};
template <typename T, void (*Free)(T*)>
using Owned = std::unique_ptr<T, Freed<T, Free>>;

struct Point {
  float at[3];
};

float distance(const float* a, const float* b) {
  const float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return std::sqrt(x * x + y * y + z * z);
}

// Where a point lies on the navmesh; no polygon means nowhere.
struct Place {
  dtPolyRef polygon = 0;
  Point point{};
};

}  // namespace

struct RecastMesh {
  Owned<dtNavMesh, dtFreeNavMesh> mesh;
  Owned<dtNavMeshQuery, dtFreeNavMeshQuery> query;
  dtQueryFilter filter;
  Settings settings{};
  std::vector<int> first_polygon;  // per tile: the number of its first polygon in the whole mesh
  std::vector<int> island;         // per polygon

  RecastMesh() {
    filter.setIncludeFlags(kWalkable);
    filter.setExcludeFlags(0);
  }

  const dtMeshTile* tile(int number) const { return static_cast<const dtNavMesh*>(mesh.get())->getTile(number); }

  int number(dtPolyRef reference) const {
    unsigned int salt, tile, polygon;
    mesh->decodePolyId(reference, salt, tile, polygon);
    return first_polygon[tile] + static_cast<int>(polygon);
  }

  // Polygons without area are closed, then everything that queries need is made.
  bool prepare() {
    int count = 0;
    for (int t = 0; t < mesh->getMaxTiles(); ++t) {
      first_polygon.push_back(count);
      if (tile(t)->header) count += tile(t)->header->polyCount;
    }
    for (int t = 0; t < mesh->getMaxTiles(); ++t) {
      if (!tile(t)->header) continue;
      for (int p = 0; p < tile(t)->header->polyCount; ++p)
        if (area(tile(t), p) < kNoArea) mesh->setPolyFlags(mesh->encodePolyId(tile(t)->salt, t, p), kDisabled);
    }
    query.reset(dtAllocNavMeshQuery());
    if (!query || dtStatusFailed(query->init(mesh.get(), kSearchNodes))) return false;
    label(count);
    return true;
  }

  // Sum of a polygon's detail triangles [m2].
  static float area(const dtMeshTile* tile, int polygon) {
    const dtPoly& poly = tile->polys[polygon];
    const dtPolyDetail& detail = tile->detailMeshes[polygon];
    float sum = 0;
    for (unsigned int t = 0; t < detail.triCount; ++t) {
      const unsigned char* triangle = &tile->detailTris[(detail.triBase + t) * 4];
      const float* corner[3];
      for (int k = 0; k < 3; ++k) {
        const unsigned int index = triangle[k];
        corner[k] = index < poly.vertCount ? &tile->verts[poly.verts[index] * 3]
                                           : &tile->detailVerts[(detail.vertBase + index - poly.vertCount) * 3];
      }
      float u[3], v[3], normal[3];
      for (int k = 0; k < 3; ++k) {
        u[k] = corner[1][k] - corner[0][k];
        v[k] = corner[2][k] - corner[1][k];
      }
      normal[0] = u[1] * v[2] - u[2] * v[1];
      normal[1] = u[2] * v[0] - u[0] * v[2];
      normal[2] = u[0] * v[1] - u[1] * v[0];
      sum += 0.5 * std::sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
    }
    return sum;
  }

  // Connected parts over walkable links; closed polygons get parts of their own.
  void label(int count) {
    island.assign(count, -1);
    int next = 0;
    std::vector<dtPolyRef> front;
    for (int t = 0; t < mesh->getMaxTiles(); ++t) {
      if (!tile(t)->header) continue;
      for (int p = 0; p < tile(t)->header->polyCount; ++p) {
        if (island[first_polygon[t] + p] >= 0) continue;
        island[first_polygon[t] + p] = next;
        front.assign(1, mesh->encodePolyId(tile(t)->salt, t, p));
        while (!front.empty()) {
          const dtMeshTile* here;
          const dtPoly* poly;
          mesh->getTileAndPolyByRefUnsafe(front.back(), &here, &poly);
          front.pop_back();
          for (unsigned int link = poly->firstLink; link != DT_NULL_LINK; link = here->links[link].next) {
            const dtPolyRef beyond = here->links[link].ref;
            const dtMeshTile* there;
            const dtPoly* neighbor;
            mesh->getTileAndPolyByRefUnsafe(beyond, &there, &neighbor);
            if (island[number(beyond)] >= 0 || !(neighbor->flags & kWalkable)) continue;
            island[number(beyond)] = next;
            front.push_back(beyond);
          }
        }
        ++next;
      }
    }
  }

  Place snap(const float* point) const {
    Place place;
    const float missing = std::numeric_limits<float>::quiet_NaN();
    place.point = {{missing, missing, missing}};
    const dtStatus status = query->findNearestPoly(point, kSnapHalfExtents, &filter, &place.polygon, place.point.at);
    if (status != DT_SUCCESS || std::isnan(place.point.at[0])) place.polygon = 0;
    return place;
  }

  bool connected(dtPolyRef a, dtPolyRef b) const { return island[number(a)] == island[number(b)]; }

  // Corners of the path between two points whose places are known; none when there is no path.
  std::vector<Point> path(const float* start, const Place& from, const float* goal, const Place& to) const {
    float apart = 0, here = 0, there = 0;
    for (int k = 0; k < 3; ++k) {
      const float gap = from.point.at[k] - to.point.at[k];
      apart += gap * gap;
      here += from.point.at[k] * from.point.at[k];
      there += to.point.at[k] * to.point.at[k];
    }
    if (apart <= 1e-10f * std::min(here, there)) return {from.point, to.point};  // the same place, as floats go
    if (!connected(from.polygon, to.polygon)) return {};
    dtPolyRef corridor[kLongest];
    int length = 0, count = 0;
    dtStatus status = query->findPath(from.polygon, to.polygon, from.point.at, to.point.at, &filter, corridor, &length, kLongest);
    // anything but plain success (a corridor cut short, or nodes run out) is no path
    if (status != DT_SUCCESS || length == 0) return {};
    std::vector<Point> corners(kLongest);
    status = query->findStraightPath(start, goal, corridor, length, corners[0].at, nullptr, nullptr, &count, kLongest);
    if (status != DT_SUCCESS || count == 0) return {};
    corners.resize(count);
    return corners;
  }
};

namespace {

Point rounded(const double* point) {
  return {{static_cast<float>(point[0]), static_cast<float>(point[1]), static_cast<float>(point[2])}};
}

// Length on the floor with exact ends, which single precision has moved.
double plan_length(const std::vector<Point>& corners, const double* start, const double* goal) {
  double length = 0, x = start[0], z = start[2];
  for (size_t k = 1; k + 1 < corners.size(); ++k) {
    length += std::hypot(corners[k].at[0] - x, corners[k].at[2] - z);
    x = corners[k].at[0];
    z = corners[k].at[2];
  }
  return length + std::hypot(goal[0] - x, goal[2] - z);
}

int bake(const Settings& s, const float* vertices, int vertex_count, const int* triangles, int triangle_count, RecastMesh& result) {
  rcContext context(false);
  const int height = static_cast<int>(std::ceil(s.agent_height / s.cell_height));
  const int climb = static_cast<int>(std::floor(s.agent_max_climb / s.cell_height));
  const int radius = static_cast<int>(std::ceil(s.agent_radius / s.cell_size));
  const int corners = static_cast<int>(s.vertices_per_polygon);
  if (corners > DT_VERTS_PER_POLYGON) return kFailed;

  float low[3], high[3];
  rcCalcBounds(vertices, vertex_count, low, high);
  int columns = 0, rows = 0;
  rcCalcGridSize(low, high, s.cell_size, &columns, &rows);
  if (columns < 1 || rows < 1) return kEmpty;

  Owned<rcHeightfield, rcFreeHeightField> solid(rcAllocHeightfield());
  if (!solid || !rcCreateHeightfield(&context, *solid, columns, rows, low, high, s.cell_size, s.cell_height)) return kFailed;
  std::vector<unsigned char> kinds(triangle_count, 0);
  rcMarkWalkableTriangles(&context, s.agent_max_slope, vertices, vertex_count, triangles, triangle_count, kinds.data());
  if (!rcRasterizeTriangles(&context, vertices, vertex_count, triangles, kinds.data(), triangle_count, *solid, climb)) return kFailed;

  if (s.low_hanging_obstacles) rcFilterLowHangingWalkableObstacles(&context, climb, *solid);
  if (s.ledge_spans) rcFilterLedgeSpans(&context, height, climb, *solid);
  if (s.low_height_spans) rcFilterWalkableLowHeightSpans(&context, height, *solid);

  Owned<rcCompactHeightfield, rcFreeCompactHeightfield> open(rcAllocCompactHeightfield());
  if (!open || !rcBuildCompactHeightfield(&context, height, climb, *solid, *open)) return kFailed;
  if (open->spanCount == 0) return kEmpty;
  if (!rcErodeWalkableArea(&context, radius, *open) || !rcBuildDistanceField(&context, *open)) return kFailed;
  const auto cells = [](float size) { return static_cast<int>(size * size); };
  if (!rcBuildRegions(&context, *open, 0, cells(s.region_min_size), cells(s.region_merge_size))) return kFailed;

  Owned<rcContourSet, rcFreeContourSet> contours(rcAllocContourSet());
  const int edge = static_cast<int>(s.edge_max_length / s.cell_size);
  if (!contours || !rcBuildContours(&context, *open, s.edge_max_error, edge, *contours)) return kFailed;
  Owned<rcPolyMesh, rcFreePolyMesh> polygons(rcAllocPolyMesh());
  if (!polygons || !rcBuildPolyMesh(&context, *contours, corners, *polygons)) return kFailed;
  if (polygons->npolys == 0) return kEmpty;
  Owned<rcPolyMeshDetail, rcFreePolyMeshDetail> detail(rcAllocPolyMeshDetail());
  const float spacing = s.detail_sample_distance < 0.9f ? 0 : s.cell_size * s.detail_sample_distance;
  const float error = s.cell_height * s.detail_sample_max_error;
  if (!detail || !rcBuildPolyMeshDetail(&context, *polygons, *open, spacing, error, *detail)) return kFailed;

  for (int p = 0; p < polygons->npolys; ++p) {
    if (polygons->areas[p] != RC_WALKABLE_AREA) continue;
    polygons->areas[p] = 0;
    polygons->flags[p] = kWalkable;
  }
  dtNavMeshCreateParams create;
  std::memset(&create, 0, sizeof(create));
  create.verts = polygons->verts;
  create.vertCount = polygons->nverts;
  create.polys = polygons->polys;
  create.polyAreas = polygons->areas;
  create.polyFlags = polygons->flags;
  create.polyCount = polygons->npolys;
  create.nvp = polygons->nvp;
  create.detailMeshes = detail->meshes;
  create.detailVerts = detail->verts;
  create.detailVertsCount = detail->nverts;
  create.detailTris = detail->tris;
  create.detailTriCount = detail->ntris;
  create.walkableHeight = s.agent_height;
  create.walkableRadius = s.agent_radius;
  create.walkableClimb = s.agent_max_climb;
  rcVcopy(create.bmin, polygons->bmin);
  rcVcopy(create.bmax, polygons->bmax);
  create.cs = s.cell_size;
  create.ch = s.cell_height;
  create.buildBvTree = true;
  unsigned char* data = nullptr;
  int size = 0;
  if (!dtCreateNavMeshData(&create, &data, &size)) return kFailed;
  result.mesh.reset(dtAllocNavMesh());
  if (!result.mesh || dtStatusFailed(result.mesh->init(data, size, DT_TILE_FREE_DATA))) {
    dtFree(data);
    return kFailed;
  }
  result.settings = s;
  return result.prepare() ? kDone : kFailed;
}

int load(const unsigned char* bytes, size_t size, RecastMesh& result) {
  FileHeader header;
  size_t at = sizeof(header);
  if (size < at) return kFailed;
  std::memcpy(&header, bytes, at);
  if (header.magic != kMagic || (header.version != 1 && header.version != kVersion)) return kFailed;
  if (header.version == kVersion) {
    if (size < at + sizeof(Settings)) return kFailed;
    std::memcpy(&result.settings, bytes + at, sizeof(Settings));
    at += sizeof(Settings);
  }
  result.mesh.reset(dtAllocNavMesh());
  if (!result.mesh || dtStatusFailed(result.mesh->init(&header.parameters))) return kFailed;
  for (int t = 0; t < header.tiles; ++t) {
    TileHeader tile;
    if (size < at + sizeof(tile)) return kFailed;
    std::memcpy(&tile, bytes + at, sizeof(tile));
    at += sizeof(tile);
    if (!tile.reference || tile.size <= 0 || size < at + static_cast<size_t>(tile.size)) return kFailed;
    auto* data = static_cast<unsigned char*>(dtAlloc(tile.size, DT_ALLOC_PERM));
    if (!data) return kFailed;
    std::memcpy(data, bytes + at, tile.size);
    at += tile.size;
    if (dtStatusFailed(result.mesh->addTile(data, tile.size, DT_TILE_FREE_DATA, tile.reference, nullptr))) {
      dtFree(data);
      return kFailed;
    }
  }
  return result.prepare() ? kDone : kFailed;
}

}  // namespace

// Goals whose places are looked up once.
struct RecastGoals {
  const RecastMesh* mesh;
  double slack;  // how far from the navmesh, in plan, a point still counts as on it [m]
  std::vector<double> at;
  std::vector<Place> place;

  bool on_mesh(const double* point, const Place& where) const {
    return where.polygon && std::hypot(where.point.at[0] - point[0], where.point.at[2] - point[2]) <= slack;
  }

  // Shortest path in plan from a point to the nearest goal. A goal is tried only while its straight distance leaves hope.
  double nearest(const double* start, std::vector<Point>* corners, int* goal) const {
    const Point from = rounded(start);
    const Place where = mesh->snap(from.at);
    double best = kInfinite;
    *goal = -1;
    if (!on_mesh(start, where)) return best;
    std::vector<std::pair<double, int>> order;
    for (size_t g = 0; g < place.size(); ++g)
      if (place[g].polygon && mesh->connected(where.polygon, place[g].polygon))
        order.emplace_back(std::hypot(at[3 * g] - start[0], at[3 * g + 2] - start[2]), static_cast<int>(g));
    std::sort(order.begin(), order.end());
    for (const auto& [straight, g] : order) {
      if (straight >= best) break;
      const Point to = rounded(&at[3 * g]);
      const std::vector<Point> found = mesh->path(from.at, where, to.at, place[g]);
      if (found.empty()) continue;
      const double length = plan_length(found, start, &at[3 * g]);
      if (length >= best) continue;
      best = length;
      *goal = g;
      if (corners) *corners = found;
    }
    return best;
  }
};

extern "C" {

// Goes up with every change of this file that changes results or the interface; tasks/navigation/recast.py names it too.
int recast_version() { return 1; }

// A navmesh of triangles. `status` says why there is none: 1 the bake failed, 2 nothing is walkable.
RecastMesh* recast_bake(const unsigned char* settings, const float* vertices, int vertex_count, const int* triangles,
                        int triangle_count, int* status) {
  auto made = std::make_unique<RecastMesh>();
  Settings values;
  std::memcpy(&values, settings, sizeof(values));
  *status = bake(values, vertices, vertex_count, triangles, triangle_count, *made);
  return *status == kDone ? made.release() : nullptr;
}

// The navmesh of a file's bytes, whose indices the caller has checked; null when they are no such file.
RecastMesh* recast_load(const unsigned char* bytes, int64_t size) {
  auto made = std::make_unique<RecastMesh>();
  return load(bytes, static_cast<size_t>(size), *made) == kDone ? made.release() : nullptr;
}

void recast_free(RecastMesh* mesh) { delete mesh; }

// Bytes of the file; copied to `out` when it is given.
int64_t recast_save(const RecastMesh* mesh, unsigned char* out) {
  FileHeader header;
  header.magic = kMagic;
  header.version = kVersion;
  header.tiles = 0;
  std::memcpy(&header.parameters, mesh->mesh->getParams(), sizeof(dtNavMeshParams));
  int64_t size = sizeof(header) + sizeof(Settings);
  for (int t = 0; t < mesh->mesh->getMaxTiles(); ++t) {
    const dtMeshTile* tile = mesh->tile(t);
    if (!tile->header || !tile->dataSize) continue;
    ++header.tiles;
    if (out) {
      const TileHeader head = {mesh->mesh->getTileRef(tile), tile->dataSize};
      std::memcpy(out + size, &head, sizeof(head));
      std::memcpy(out + size + sizeof(head), tile->data, tile->dataSize);
    }
    size += sizeof(TileHeader) + tile->dataSize;
  }
  if (out) {
    std::memcpy(out, &header, sizeof(header));
    std::memcpy(out + sizeof(header), &mesh->settings, sizeof(Settings));
  }
  return size;
}

int recast_polygon_count(const RecastMesh* mesh) { return static_cast<int>(mesh->island.size()); }

// Connected part of every polygon.
void recast_islands(const RecastMesh* mesh, int* out) { std::copy(mesh->island.begin(), mesh->island.end(), out); }

// For each point the nearest place on the navmesh and its polygon, -1 where there is none in reach.
void recast_snap(const RecastMesh* mesh, const double* points, int count, double* places, int* polygons) {
  for (int i = 0; i < count; ++i) {
    const Point point = rounded(points + 3 * i);
    const Place place = mesh->snap(point.at);
    for (int k = 0; k < 3; ++k) places[3 * i + k] = place.point.at[k];
    polygons[i] = place.polygon ? mesh->number(place.polygon) : -1;
  }
}

// Length in space of the path between two points [m], as habitat-sim gives it, and its up to 256 corners; infinite without.
double recast_path(const RecastMesh* mesh, const float* start, const float* goal, float* corners, int* count) {
  const Place from = mesh->snap(start), to = mesh->snap(goal);
  *count = 0;
  if (!from.polygon || !to.polygon) return kInfinite;
  const std::vector<Point> found = mesh->path(start, from, goal, to);
  if (found.empty()) return kInfinite;
  *count = static_cast<int>(found.size());
  std::memcpy(corners, found.data(), found.size() * sizeof(Point));
  float length = 0;
  for (size_t k = 1; k < found.size(); ++k) length += distance(found[k - 1].at, found[k].at);
  return length;
}

// Share of a straight move over the floor (y = 0) that is free, 0 to 1; one means that it meets no edge.
double recast_clear_share(const RecastMesh* mesh, double start_x, double start_z, double end_x, double end_z) {
  const double ends[2][3] = {{start_x, 0, start_z}, {end_x, 0, end_z}};
  const Point from = rounded(ends[0]), to = rounded(ends[1]);
  const Place place = mesh->snap(from.at);
  if (!place.polygon) return 0;
  float share = 0, normal[3];
  dtPolyRef crossed[kLongest];
  int count = 0;
  if (mesh->query->raycast(place.polygon, place.point.at, to.at, &mesh->filter, &share, normal, crossed, &count, kLongest) != DT_SUCCESS)
    return 0;
  return std::min(1.0, static_cast<double>(share));
}

RecastGoals* recast_goals(const RecastMesh* mesh, const double* points, int count, double slack) {
  auto* goals = new RecastGoals{mesh, slack, std::vector<double>(points, points + 3 * count), {}};
  for (int g = 0; g < count; ++g) {
    Place place = mesh->snap(rounded(points + 3 * g).at);
    if (!goals->on_mesh(points + 3 * g, place)) place.polygon = 0;
    goals->place.push_back(place);
  }
  return goals;
}

void recast_free_goals(RecastGoals* goals) { delete goals; }

// Distance in plan from a point of the floor to its nearest goal [m]; infinite without a path.
double recast_goal_distance(const RecastGoals* goals, double x, double z) {
  const double start[3] = {x, 0, z};
  int goal;
  return goals->nearest(start, nullptr, &goal);
}

// The path to the nearest goal: up to 256 corners, how many, which goal (-1: none), and its length in plan [m].
double recast_goal_path(const RecastGoals* goals, double x, double z, double* corners, int* count, int* goal) {
  const double start[3] = {x, 0, z};
  std::vector<Point> found;
  const double length = goals->nearest(start, &found, goal);
  *count = static_cast<int>(found.size());
  for (size_t k = 0; k < found.size(); ++k)
    for (int axis = 0; axis < 3; ++axis) corners[3 * k + axis] = found[k].at[axis];
  return length;
}

}  // extern "C"
