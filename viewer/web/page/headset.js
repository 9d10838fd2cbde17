// The scene around a headset, where the browser has WebXR.
import { Pose, dot, plus } from './pose.js';

/** Metres from the head to the point straight ahead, at first. */
const REACH = 2;

/** Speed of sticks, per second: metres, radians. */
const [SPEED, TURN] = [1.5, 1];

/** Leaning of a stick that counts. */
const LEAST = 0.15;

/** Whether a headset can be used. */
export const hasHeadset = async () =>
  (await navigator.xr?.isSessionSupported('immersive-vr').catch(() => false)) ?? false;

export class Headset {
  #last = 0;

  /**
   * Show the scene in the headset, from the viewer's pose on, upright.
   *
   * @param {object} viewer has `renderer`, `pose`, `up`, `scenes` and `paint(pose, lens, target)`
   * @param {(pose: Pose) => void} ended called with the last pose
   */
  static async enter(viewer, ended) {
    const { gl } = viewer.renderer;
    const session = await navigator.xr.requestSession('immersive-vr');
    const headset = new Headset(viewer, session);
    session.addEventListener('end', () => ended(headset.seen));
    try {
      await gl.makeXRCompatible();
      const layer = { alpha: false, antialias: false, depth: false, stencil: false };
      session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl, layer) });
      headset.space = await session.requestReferenceSpace('local');
    } catch (error) {
      await session.end();
      throw error;
    }
    session.requestAnimationFrame((now, frame) => headset.#step(now, frame));
    return session;
  }

  constructor(viewer, session) {
    const { pose, up } = viewer;
    const level = plus(plus(pose.eye, pose.turn[2]), up, -dot(up, pose.turn[2]));
    const upright = Pose.facing(pose.eye, level, up) ?? pose;
    this.viewer = viewer;
    this.session = session;
    this.seen = pose;
    this.base = new Pose(upright.eye, upright.turn, 0); // where the headset began
    this.metre = pose.distance / REACH;
  }

  #step(now, frame) {
    const { session, viewer, space } = this;
    session.requestAnimationFrame((...given) => this.#step(...given));
    this.#fly(Math.min((now - this.#last) / 1000, 0.1));
    this.#last = now;
    const head = frame.getViewerPose(space);
    if (!head) return; // the headset is not tracked
    this.seen = this.#poseOf(head.transform.matrix);
    const { baseLayer: layer } = session.renderState;
    const eyes = head.views.map((view) => {
      const { x, y, width, height } = layer.getViewport(view);
      const lens = lensOf(view.projectionMatrix, width, height);
      return { lens, corner: [x, y], pose: this.#poseOf(view.transform.matrix) };
    });
    for (const scene of viewer.scenes) {
      scene.aim(this.seen, eyes[0].lens);
      scene.sort(this.seen);
    }
    for (const { lens, corner, pose } of eyes) {
      viewer.paint(pose, lens, { framebuffer: layer.framebuffer, corner, size: lens.size });
    }
  }

  /** The pose of a matrix of the headset: columns right, up, back and position, metres. */
  #poseOf(matrix) {
    const [right, down, forward] = this.base.turn;
    const turned = (k) =>
      plus(plus(plus([0, 0, 0], right, matrix[k]), down, -matrix[k + 1]), forward, -matrix[k + 2]);
    const eye = plus(this.base.eye, turned(12), this.metre);
    const flipped = (k) => turned(k).map((value) => -value);
    return new Pose(eye, [turned(0), flipped(4), flipped(8)], REACH * this.metre);
  }

  /** Fly where the left stick leans, as the head looks; turn and rise by the right one. */
  #fly(seconds) {
    const { base, seen, session, viewer } = this;
    const step = SPEED * this.metre * seconds;
    for (const { handedness, gamepad } of session.inputSources) {
      const leans = gamepad?.axes.slice(2) ?? [];
      const [aside = 0, back = 0] = leans.map((lean) => (Math.abs(lean) < LEAST ? 0 : lean));
      if (handedness === 'left') {
        base.eye = plus(plus(base.eye, seen.turn[0], aside * step), seen.turn[2], -back * step);
      } else {
        base.orbit(-aside * TURN * seconds, 0, viewer.up);
        base.eye = plus(base.eye, viewer.up, -back * step);
      }
    }
  }
}

/** The lens of a projection of WebGL, column by column, in pixels. */
const lensOf = (projection, width, height) => ({
  focal: [(projection[0] * width) / 2, (projection[5] * height) / 2],
  centre: [((1 - projection[8]) * width) / 2, ((1 + projection[9]) * height) / 2],
  size: [width, height],
});
