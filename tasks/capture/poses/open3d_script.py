"""Run by an interpreter that has `open3d`, never imported: frames of color and depth in, poses out.

Only Open3D and NumPy are there. The folder that is named holds `color.u1` (n, h, w, 3), `depth.f4` (n, h, w) [m], `intrinsics.f8`
(n, 4) [px], `given.f8` (n, 4, 4) [m], which is NaN where nobody gave a pose, and `settings.json`. `poses.f8` (n, 4, 4), camera to the
frame of the first one that has a pose, NaN where there is none, and `said.json` are left in it.

Frames follow one another by visual odometry; of them, key frames become nodes of a graph, whose further edges are pairs that see the
same surface (colored registration); the graph is relaxed, and what does not fit is pruned. Sources: Park et al., "Colored Point Cloud
Registration Revisited", ICCV 2017; Choi et al., "Robust Reconstruction of Indoor Scenes", CVPR 2015.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np

# Sums of several threads have no order. OMP_NUM_THREADS is 1 already; of the other threads there are as many as cores that one may use.
if hasattr(os, "sched_setaffinity"):
    _cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {_cores[os.getpid() % len(_cores)]})

import open3d as o3d

REGISTRATION = o3d.pipelines.registration
ODOMETRY = o3d.pipelines.odometry


class Frames:
    """Frames in memory, as pictures and as clouds. settings: as `settings.json` has them."""

    def __init__(self, folder: Path) -> None:
        self.settings = json.loads((folder / "settings.json").read_text())
        count, height, width = self.settings["shape"]
        self.color = np.memmap(folder / "color.u1", np.uint8, "r", shape=(count, height, width, 3))
        self.depth = np.memmap(folder / "depth.f4", "<f4", "r", shape=(count, height, width))
        self.intrinsics = np.fromfile(folder / "intrinsics.f8", "<f8").reshape(count, 4)
        self.given = np.fromfile(folder / "given.f8", "<f8").reshape(count, 4, 4)
        self.clouds: dict[int, list[o3d.geometry.PointCloud]] = {}

    def __len__(self) -> int:
        return len(self.depth)

    def camera(self, index: int) -> o3d.camera.PinholeCameraIntrinsic:
        """Pixel centers at whole numbers."""
        fx, fy, cx, cy = self.intrinsics[index]
        return o3d.camera.PinholeCameraIntrinsic(self.depth.shape[2], self.depth.shape[1], fx, fy, cx, cy)

    def picture(self, index: int) -> o3d.geometry.RGBDImage:
        """Gray and depth, as odometry takes them."""
        return o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(np.ascontiguousarray(self.color[index])), o3d.geometry.Image(np.ascontiguousarray(self.depth[index])),
            depth_scale=1.0, depth_trunc=self.settings["max_depth_m"], convert_rgb_to_intensity=True,
        )  # fmt: skip

    def points(self, index: int, most: int) -> np.ndarray:
        """Some of a frame's points, evenly over the picture [m], shape (n, 3)."""
        depth = self.depth[index]
        rows, columns = np.nonzero((depth > 0) & (depth < self.settings["max_depth_m"]))
        step = max(1, len(rows) // most)
        rows, columns = rows[::step], columns[::step]
        fx, fy, cx, cy = self.intrinsics[index]
        z = depth[rows, columns].astype(np.float64)
        return np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=1)

    def has_surface(self, index: int) -> bool:
        """Whether a frame shows enough for a registration."""
        return len(self.cloud(index, 0).points) >= self.settings["least_points"]

    def cloud(self, index: int, level: int) -> o3d.geometry.PointCloud:
        """A frame's cloud with normals, at a voxel of the settings' levels."""
        if index not in self.clouds:
            image = o3d.geometry.RGBDImage.create_from_color_and_depth(
                o3d.geometry.Image(np.ascontiguousarray(self.color[index])), o3d.geometry.Image(np.ascontiguousarray(self.depth[index])),
                depth_scale=1.0, depth_trunc=self.settings["max_depth_m"], convert_rgb_to_intensity=False,
            )  # fmt: skip
            whole = o3d.geometry.PointCloud.create_from_rgbd_image(image, self.camera(index))
            levels = []
            for voxel in self.settings["voxels_m"]:
                thin = whole.voxel_down_sample(voxel)
                thin.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2.5 * voxel, max_nn=30))
                if thin.has_normals():
                    thin.orient_normals_towards_camera_location()
                levels.append(thin)
            self.clouds[index] = levels
        return self.clouds[index][level]


def agreement(frames: Frames, first: int, second: int, motion: np.ndarray) -> tuple[float, float]:
    """How well a motion, first camera to second, explains the depth of both: share of the first frame's points that lie in the second
    picture where it has depth; and of these the share that it confirms."""
    points = frames.points(first, 1500)
    local = points @ motion[:3, :3].T + motion[:3, 3]
    z = np.maximum(local[:, 2], 1e-6)
    fx, fy, cx, cy = frames.intrinsics[second]
    u, v = np.round(local[:, 0] / z * fx + cx), np.round(local[:, 1] / z * fy + cy)
    depth = frames.depth[second]
    inside = (local[:, 2] > 0.1) & (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    seen = depth[v[inside].astype(int), u[inside].astype(int)].astype(np.float64)
    readable = seen > 0
    if len(points) == 0 or readable.sum() < 20:
        return 0.0, 0.0
    off = np.abs(seen - local[inside, 2])[readable]
    return float(readable.sum() / len(points)), float((off < 0.02 + 0.01 * seen[readable]).mean())


def score(frames: Frames, first: int, second: int, motion: np.ndarray) -> float:
    """Share of the first frame's points that the second one confirms: overlap times agreement."""
    overlap, agreed = agreement(frames, first, second, motion)
    return overlap * agreed


def followed(frames: Frames, first: int, second: int, guesses: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """The motion from one frame to a near one, first camera to second, and its score: odometry from each guess, the best of them."""
    option = ODOMETRY.OdometryOption(
        iteration_number_per_pyramid_level=o3d.utility.IntVector([20, 10, 5]), depth_diff_max=0.07, depth_min=0.1,
        depth_max=frames.settings["max_depth_m"],
    )  # fmt: skip
    best, best_score = np.eye(4), -1.0
    for guess in guesses:
        if best_score > frames.settings["sure_score"]:
            break
        done, motion, _ = ODOMETRY.compute_rgbd_odometry(
            frames.picture(first),
            frames.picture(second),
            frames.camera(second),
            guess,
            ODOMETRY.RGBDOdometryJacobianFromHybridTerm(),
            option,
        )
        for candidate in ([motion] if done else []) + [guess]:
            if (own := score(frames, first, second, candidate)) > best_score:
                best, best_score = candidate, own
    return best, best_score


def registered(frames: Frames, first: int, second: int, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The motion between two frames that see the same surface: colored registration from coarse to fine; its information matrix, and
    the share of the points that the other frame confirms, of those that it could."""
    motion = guess
    if not (frames.has_surface(first) and frames.has_surface(second)):
        return guess, np.eye(6), 0.0
    for level, voxel in enumerate(frames.settings["voxels_m"]):
        reach = 1.5 * voxel + (0.05 if level == 0 else 0.0)
        try:
            result = REGISTRATION.registration_colored_icp(
                frames.cloud(first, level), frames.cloud(second, level), reach, motion,
                REGISTRATION.TransformationEstimationForColoredICP(lambda_geometric=0.9),
                REGISTRATION.ICPConvergenceCriteria(relative_fitness=1e-6, relative_rmse=1e-6, max_iteration=30),
            )  # fmt: skip
        except RuntimeError:  # it has no other way to say that two clouds share nothing, in any of its rounds
            return guess, np.eye(6), 0.0
        motion = result.transformation
    last = len(frames.settings["voxels_m"]) - 1
    information = REGISTRATION.get_information_matrix_from_point_clouds(
        frames.cloud(first, last), frames.cloud(second, last), 1.5 * frames.settings["voxels_m"][last], motion
    )
    return np.array(motion), information, agreement(frames, first, second, motion)[1]


def found_again(frames: Frames, first: int, second: int) -> np.ndarray | None:
    """A motion between two frames of which nothing is known, by features of their surfaces; None where they have nothing in common."""
    if not (frames.has_surface(first) and frames.has_surface(second)):
        return None
    voxel = frames.settings["voxels_m"][0]
    clouds = [frames.cloud(index, 0) for index in (first, second)]
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * voxel, max_nn=100)
    features = [REGISTRATION.compute_fpfh_feature(cloud, search) for cloud in clouds]
    result = REGISTRATION.registration_ransac_based_on_feature_matching(
        *clouds, *features, True, 1.5 * voxel, REGISTRATION.TransformationEstimationPointToPoint(False), 3,
        [REGISTRATION.CorrespondenceCheckerBasedOnEdgeLength(0.9), REGISTRATION.CorrespondenceCheckerBasedOnDistance(1.5 * voxel)],
        REGISTRATION.RANSACConvergenceCriteria(100_000, 0.999),
    )  # fmt: skip
    return np.array(result.transformation) if result.fitness > 0 else None


def chained(frames: Frames) -> tuple[np.ndarray, np.ndarray]:
    """Poses by following, camera to the first frame of their piece, shape (n, 4, 4), and the piece that each frame is of, shape (n,).

    A piece ends where a frame fits the one before by no means. Given poses are guesses, as is to stand still or to go on as before.
    """
    count, least = len(frames), frames.settings["least_score"]
    poses, piece = np.tile(np.eye(4), (count, 1, 1)), np.zeros(count, dtype=int)
    before = np.eye(4)
    for index in range(1, count):
        guesses = [before, np.eye(4)]
        pair = frames.given[index - 1 : index + 1]
        if np.isfinite(pair).all():
            guesses.insert(0, np.linalg.inv(pair[1]) @ pair[0])
        motion, own = followed(frames, index - 1, index, guesses)
        if own < least and (again := found_again(frames, index - 1, index)) is not None:
            refined, _, agreed = registered(frames, index - 1, index, again)
            if agreed > frames.settings["least_agreement"] and score(frames, index - 1, index, refined) > max(own, least):
                motion, own = refined, score(frames, index - 1, index, refined)
        if own < least:
            piece[index] = piece[index - 1] + 1
            poses[index] = frames.given[index] if np.isfinite(frames.given[index]).all() else np.eye(4)
            before = np.eye(4)
        else:
            piece[index] = piece[index - 1]
            poses[index] = poses[index - 1] @ np.linalg.inv(motion)
            before = motion
    return poses, piece


def key_frames(frames: Frames, poses: np.ndarray, piece: np.ndarray) -> list[int]:
    """Frames that stand for those after them: one for every so many metres and radians, and the first of every piece."""
    keys = [0]
    for index in range(1, len(frames)):
        step = np.linalg.inv(poses[keys[-1]]) @ poses[index]
        turn = np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1))
        far = np.linalg.norm(step[:3, 3]) > frames.settings["key_m"] or turn > frames.settings["key_radians"]
        if piece[index] != piece[keys[-1]] or far:
            keys.append(index)
    return keys


def relaxed(frames: Frames, keys: list[int], poses: np.ndarray, piece: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
    """Key frames' poses once pairs that see the same surface agree on it, camera to world, NaN where nothing joins them to the largest
    part; and how many edges there were."""
    settings = frames.settings
    nodes = np.array([poses[key] for key in keys])
    pieces = piece[keys]
    steps = [
        (i, i + 1, *registered(frames, keys[i], keys[i + 1], np.linalg.inv(nodes[i + 1]) @ nodes[i]))
        for i in range(len(keys) - 1)
        if pieces[i] == pieces[i + 1]
    ]
    firm = []
    for i, j, motion, information, agreed in steps:
        chain = np.linalg.inv(nodes[j]) @ nodes[i]
        if agreed < agreement(frames, keys[i], keys[j], chain)[1]:
            motion = chain
        firm.append((i, j, motion, information))
    tried: dict[tuple[int, int], tuple[np.ndarray, np.ndarray] | None] = {}
    counts = {"keys": len(keys), "steps": len(firm), "loops": 0, "kept": 0}
    for _ in range(settings["rounds"]):
        for i, j in candidates(frames, keys, nodes, pieces):
            if tried.get((i, j)) is None:
                tried[i, j] = closed(frames, keys[i], keys[j], np.linalg.inv(nodes[j]) @ nodes[i], pieces[i] == pieces[j])
        graph = REGISTRATION.PoseGraph()
        for node in nodes:
            graph.nodes.append(REGISTRATION.PoseGraphNode(node))
        for i, j, motion, information in firm:
            graph.edges.append(REGISTRATION.PoseGraphEdge(i, j, motion, information, uncertain=False))
        loops = [(pair, edge) for pair, edge in sorted(tried.items()) if edge is not None]
        for (i, j), (motion, information) in loops:
            graph.edges.append(REGISTRATION.PoseGraphEdge(i, j, motion, information, uncertain=True))
        REGISTRATION.global_optimization(
            graph, REGISTRATION.GlobalOptimizationLevenbergMarquardt(), REGISTRATION.GlobalOptimizationConvergenceCriteria(),
            REGISTRATION.GlobalOptimizationOption(
                max_correspondence_distance=1.5 * settings["voxels_m"][-1], edge_prune_threshold=0.25, preference_loop_closure=2.0,
                reference_node=0,
            ),
        )  # fmt: skip
        nodes = np.array([node.pose for node in graph.nodes])
        kept = [(edge.source_node_id, edge.target_node_id) for edge in graph.edges]
        counts |= {"loops": len(loops), "kept": len(kept) - len(firm)}
    own = np.array(largest(len(keys), kept))
    nodes[~own] = np.nan
    return nodes, counts


def candidates(frames: Frames, keys: list[int], nodes: np.ndarray, pieces: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of key frames that should see the same surface, by their poses, some for each frame, those that share most first; and of
    two pieces whose places are not known in one frame, pairs at even distances."""
    pairs: list[tuple[int, int]] = []
    middles = [frames.points(key, 200) for key in keys]
    for j in range(len(keys)):
        shared = []
        for i in range(j - 1):
            if pieces[i] != pieces[j] and not np.isfinite(frames.given[[keys[i], keys[j]]]).all():
                continue
            motion = np.linalg.inv(nodes[j]) @ nodes[i]
            local = middles[i] @ motion[:3, :3].T + motion[:3, 3]
            fx, fy, cx, cy = frames.intrinsics[keys[j]]
            z = np.maximum(local[:, 2], 1e-6)
            u, v = local[:, 0] / z * fx + cx, local[:, 1] / z * fy + cy
            height, width = frames.depth.shape[1:]
            inside = (local[:, 2] > 0.1) & (local[:, 2] < frames.settings["max_depth_m"]) & (u > 0) & (v > 0) & (u < width) & (v < height)
            if len(local) and inside.mean() > frames.settings["least_overlap"]:
                shared.append((float(inside.mean()), i))
        pairs += [(i, j) for _, i in sorted(shared, reverse=True)[: frames.settings["loops_per_frame"]]]
    lost = sorted({int(p) for p in pieces[1:]} - {int(pieces[0])})
    for piece in lost:
        own, before = np.flatnonzero(pieces == piece), np.flatnonzero(pieces < piece)
        if not np.isfinite(frames.given[[keys[k] for k in own]]).all():
            step = max(1, len(before) // 12)
            pairs += [(int(i), int(own[len(own) // 2])) for i in before[::step]]
    return pairs


def closed(frames: Frames, first: int, second: int, guess: np.ndarray, is_near: bool) -> tuple[np.ndarray, np.ndarray] | None:
    """An edge between two frames that should see the same surface; None where they do not agree on one. Where the guess means
    nothing (`is_near` False), one that features give is taken."""
    settings = frames.settings
    if not is_near and not np.isfinite(frames.given[[first, second]]).all():
        again = found_again(frames, first, second)
        if again is None:
            return None
        guess = again
    motion, information, agreed = registered(frames, first, second, guess)
    overlap, _ = agreement(frames, first, second, motion)
    return (motion, information) if agreed > settings["loop_agreement"] and overlap > 0.6 * settings["least_overlap"] else None


def largest(count: int, edges: list[tuple[int, int]]) -> list[bool]:
    """Nodes of the largest part that edges join; of two, the first."""
    root = list(range(count))

    def top(node: int) -> int:
        while root[node] != node:
            node = root[node]
        return node

    for i, j in edges:
        a, b = sorted((top(i), top(j)))
        root[b] = a
    tops = [top(node) for node in range(count)]
    most = max(sorted(set(tops)), key=tops.count)
    return [own == most for own in tops]


def between(keys: list[int], nodes: np.ndarray, poses: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """All frames' poses: each follows the key frame before it, and what the next one moved is shared out over those between them."""
    result = np.full_like(poses, np.nan)
    for number, key in enumerate(keys):
        end = keys[number + 1] if number + 1 < len(keys) else len(poses)
        if not np.isfinite(nodes[number]).all():
            continue
        moved = nodes[number] @ np.linalg.inv(poses[key])
        following = number + 1 < len(keys) and piece[end] == piece[key] and np.isfinite(nodes[number + 1]).all()
        off = np.linalg.inv(moved @ poses[end]) @ nodes[number + 1] if following else np.eye(4)
        for index in range(key, end):
            result[index] = moved @ poses[index] @ part_of(off, (index - key) / max(end - key, 1))
    return result


def part_of(motion: np.ndarray, share: float) -> np.ndarray:
    """A share of a small motion."""
    turn = np.arccos(np.clip((np.trace(motion[:3, :3]) - 1) / 2, -1, 1))
    part = np.eye(4)
    if turn > 1e-9:
        axis = np.array([motion[2, 1] - motion[1, 2], motion[0, 2] - motion[2, 0], motion[1, 0] - motion[0, 1]]) / (2 * np.sin(turn))
        part[:3, :3] = o3d.geometry.get_rotation_matrix_from_axis_angle(axis * turn * share)
    part[:3, 3] = motion[:3, 3] * share
    return part


def main(folder: Path) -> None:
    """Pose the frames in the folder."""
    frames = Frames(folder)
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    o3d.utility.random.seed(frames.settings["seed"])
    poses, piece = chained(frames)
    keys = key_frames(frames, poses, piece)
    nodes, counts = relaxed(frames, keys, poses, piece)
    result = between(keys, nodes, poses, piece)
    result.astype("<f8").tofile(folder / "poses.f8")
    summary = {"version": o3d.__version__, "pieces": int(piece.max()) + 1, **counts}
    (folder / "said.json").write_text(json.dumps(summary))


main(Path(sys.argv[1]))
