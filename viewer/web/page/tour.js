// A tour: from view to view, or along a camera path.
import { Pose, dot, plus } from './pose.js';

/** Seconds from view to view, and at each of them. */
const [LEG, STAY] = [3, 1];

/** Maximum number of views of a tour. */
const MOST = 12;

const LENS = ['width', 'height', 'fx', 'fy', 'cx', 'cy'];

/** A share of time as a share of the way, which begins and ends slowly. */
export const eased = (share) => share * share * (3 - 2 * share);

export class Tour {
  /**
   * @param {object} viewer has `pose`, `frame` (a lens), `views`, `view`, `hasMoved`, `middle`,
   *   `poseOf(view)` and `passed(view)`
   * @param {{time: number}[]} [path] cameras with times; by default, the tour goes through views
   */
  constructor(viewer, path) {
    this.viewer = viewer;
    this.path = path;
  }

  /** A function that moves the camera by seconds, from where it is, again and again. */
  begin() {
    const { viewer, path } = this;
    const stops = path ? path.map((camera) => this.#stop(camera)) : this.#stops();
    let [from, time, until] = [this.#stop(viewer.views[viewer.view], viewer.pose), 0, LEG];
    let k = stops.length > 1 && !viewer.hasMoved && stops[0].view === viewer.view ? 1 : 0;
    return (seconds) => {
      time += seconds;
      while (time >= until) {
        time -= until;
        from = stops[k];
        if (!path) viewer.passed(from.view);
        k = (k + 1) % stops.length;
        until = path && k > 0 ? Math.max(stops[k].time - from.time, 1e-3) : LEG + STAY;
      }
      const isOnPath = path && from.time < stops[k].time;
      const share = isOnPath ? time / until : eased(Math.min(time / LEG, 1));
      viewer.pose = from.pose.towards(stops[k].pose, share);
      const lens = LENS.map((name) => [
        name,
        from.camera[name] * (1 - share) + stops[k].camera[name] * share,
      ]);
      viewer.frame = Object.fromEntries(lens);
    };
  }

  #stop(camera, pose = Pose.of(camera, this.viewer.middle)) {
    return { camera, pose, time: camera.time };
  }

  /** Some of the views, each next to the one before, from the current one on. */
  #stops() {
    const { views, view: current } = this.viewer;
    const step = Math.max(views.length / MOST, 1);
    const left = views.flatMap((camera, view) =>
      view % step < 1
        ? [{ ...this.#stop(camera, this.viewer.poseOf(view)), view }]
        : [],
    );
    let last = this.viewer.poseOf(current);
    const found = [];
    while (left.length) {
      const away = ({ pose }) =>
        Math.hypot(...plus(pose.eye, last.eye, -1)) / last.distance - dot(pose.turn[2], last.turn[2]);
      left.sort((a, b) => away(b) - away(a));
      found.push(left.pop());
      last = found.at(-1).pose;
    }
    return found;
  }
}
