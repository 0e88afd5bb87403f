// Carts that drove: the true way of one, its sub-goals, and as a ring where it believed to be.

import { ConeGeometry, CylinderGeometry, Group, Mesh, MeshLambertMaterial, PerspectiveCamera, TorusGeometry, Vector3 } from "three";
import { dot, line } from "./marks.js";

const TRUTH = 0x1f6feb;
const BELIEF = 0xe8890c;
const SUBGOAL = 0x1a7f37;
const HEIGHT_M = 0.25; // rows do not say how high a cart is, and the default one is so
const VIEW_DEGREES = 58; // as episodes have it
const FASTER = 4; // than it drove

/** One run in the scene: its ways, its sub-goals, the cart. */
export class Drive {
  constructor(run) {
    this.run = run;
    const raised = (points) => points.map(([x, y]) => new Vector3(x, y, 0.04));
    this.marks = new Group().add(line(raised(run.track), TRUTH), line(raised(run.estimate), BELIEF));
    for (const [x, y] of run.subgoals) this.marks.add(dot(new Vector3(x, y, 0.04), 0.04, SUBGOAL));
    this.body = new Group();
    this.cart = new Group();
    const trunk = new Mesh(new CylinderGeometry(run.radius, run.radius, HEIGHT_M, 24), new MeshLambertMaterial({ color: TRUTH }));
    trunk.rotation.x = Math.PI / 2;
    trunk.position.z = HEIGHT_M / 2;
    const nose = new Mesh(new ConeGeometry(run.radius * 0.5, run.radius, 12), new MeshLambertMaterial({ color: 0xffd33d }));
    nose.rotation.z = -Math.PI / 2;
    nose.position.set(run.radius * 0.9, 0, HEIGHT_M);
    this.cart.add(trunk, nose);
    this.belief = new Mesh(new TorusGeometry(run.radius + 0.03, 0.012, 8, 40), new MeshLambertMaterial({ color: BELIEF }));
    this.body.add(this.cart, this.belief);
    this.camera = new PerspectiveCamera(VIEW_DEGREES, 4 / 3, 0.05, 60);
    this.camera.up.set(0, 0, 1);
  }

  /** Show the moment between two records, 0 to the count of them less one. */
  at(moment) {
    const [x, y, yaw] = between(this.run.track, moment);
    this.cart.position.set(x, y, 0);
    this.cart.rotation.z = yaw;
    const [bx, by] = between(this.run.estimate, moment);
    this.belief.position.set(bx, by, 0.05);
    this.camera.position.set(x, y, HEIGHT_M);
    this.camera.lookAt(x + Math.cos(yaw), y + Math.sin(yaw), HEIGHT_M);
  }

  get end() {
    return this.run.track.length - 1;
  }

  /** How long it is played [s]. */
  get seconds() {
    return Math.max(2, this.run.seconds / FASTER);
  }

  get name() {
    return { drive: this.run.id };
  }
}

/** A pose between two of a list. */
function between(poses, moment) {
  const last = poses.length - 1;
  const index = Math.min(last, Math.floor(moment));
  const [from, to] = [poses[index], poses[Math.min(last, index + 1)]];
  const share = moment - index;
  const turn = Math.atan2(Math.sin(to[2] - from[2]), Math.cos(to[2] - from[2]));
  return [from[0] + (to[0] - from[0]) * share, from[1] + (to[1] - from[1]) * share, from[2] + turn * share];
}
