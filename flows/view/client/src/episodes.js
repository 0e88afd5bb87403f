// Episodes of navigation: the path of one, the agent on it, and what it sees.

import { CylinderGeometry, ConeGeometry, Group, Mesh, MeshLambertMaterial, PerspectiveCamera, Vector3 } from "three";
import { dot, line } from "./marks.js";

const FORWARD_M = 0.25;
const TURN = Math.PI / 6;
const STRAY_M = 0.05; // replayed actions that end farther off were made with other steps: then the path itself is followed
const ACTION_SECONDS = 0.25;
const VIEW_DEGREES = 58; // upright; 79 across, as Habitat's agents see

/** Poses (x, y, yaw) before the first action and after each. */
export function posesOf(episode) {
  let [x, y] = episode.start;
  let yaw = episode.yaw;
  const poses = [[x, y, yaw]];
  for (const action of episode.actions) {
    if (action === "forward") {
      x += FORWARD_M * Math.cos(yaw);
      y += FORWARD_M * Math.sin(yaw);
    } else if (action === "left") yaw += TURN;
    else if (action === "right") yaw -= TURN;
    poses.push([x, y, yaw]);
  }
  return Math.hypot(x - episode.final[0], y - episode.final[1]) < STRAY_M ? poses : alongPath(episode);
}

function alongPath(episode) {
  const corners = [episode.start, ...episode.path, episode.final];
  return corners.map(([x, y], index) => {
    const [nx, ny] = corners[Math.min(index + 1, corners.length - 1)];
    const [px, py] = corners[Math.max(index - 1, 0)];
    return index < corners.length - 1 ? [x, y, Math.atan2(ny - y, nx - x)] : [x, y, Math.atan2(y - py, x - px)];
  });
}

/** One episode in the scene: its way, its goal, the agent. */
export class Walk {
  constructor(episode, navmeshes) {
    const navmesh = navmeshes.find((row) => row.agent === episode.agent);
    this.episode = episode;
    this.poses = posesOf(episode);
    const height = navmesh?.height ?? 0.88;
    const radius = navmesh?.radius ?? 0.18;
    const raised = (points) => points.map(([x, y]) => new Vector3(x, y, 0.04));
    this.marks = new Group().add(
      line(raised(this.poses), 0xbf3989), line(raised(episode.path), 0xffffff),
      dot(new Vector3(episode.goal[0], episode.goal[1], 0.04), 0.07, 0xbf3989),
    );
    this.body = new Group();
    const trunk = new Mesh(new CylinderGeometry(radius, radius, height, 20), new MeshLambertMaterial({ color: 0xbf3989 }));
    trunk.rotation.x = Math.PI / 2;
    trunk.position.z = height / 2;
    const nose = new Mesh(new ConeGeometry(radius * 0.6, radius * 1.4, 12), new MeshLambertMaterial({ color: 0xffd33d }));
    nose.rotation.z = -Math.PI / 2;
    nose.position.set(radius * 1.2, 0, height * 0.9);
    this.body.add(trunk, nose);
    this.camera = new PerspectiveCamera(VIEW_DEGREES, 4 / 3, 0.05, 60);
    this.camera.up.set(0, 0, 1);
    this.eye = height;
  }

  /** The moment between two actions that is shown, 0 to the count of actions. */
  at(moment) {
    const last = this.poses.length - 1;
    const index = Math.min(last, Math.floor(moment));
    const [from, to] = [this.poses[index], this.poses[Math.min(last, index + 1)]];
    const share = moment - index;
    const [x, y] = [0, 1].map((axis) => from[axis] + (to[axis] - from[axis]) * share);
    const yaw = from[2] + Math.atan2(Math.sin(to[2] - from[2]), Math.cos(to[2] - from[2])) * share;
    this.body.position.set(x, y, 0);
    this.body.rotation.z = yaw;
    this.camera.position.set(x, y, this.eye);
    this.camera.lookAt(x + Math.cos(yaw), y + Math.sin(yaw), this.eye);
  }

  get end() {
    return this.poses.length - 1;
  }

  /** How long it is played [s]. */
  get seconds() {
    return Math.max(1, this.end * ACTION_SECONDS);
  }

  get name() {
    return { episode: this.episode.id };
  }
}
