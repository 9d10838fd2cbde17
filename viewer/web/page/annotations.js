// Annotations: numbered points of the scene, each with a title and a text.
import { Pose, dot, plus } from './pose.js';

const $ = (id) => document.getElementById(id);

export class Annotations {
  /**
   * @param {object} viewer has `pose`, `views`, `poseOf(view)` and `fly(pose, view)`
   * @param {{position: number[], title: string, text: string, view?: number}[]} listed
   * @param {() => void} changed called when another is open
   */
  constructor(viewer, listed, changed) {
    Object.assign(this, { viewer, listed, changed });
    this.shown = 0; // number of the open one, from 1 on
    this.buttons = listed.map(({ title }, k) => {
      const button = document.createElement('button');
      button.type = 'button';
      button.textContent = k + 1;
      button.ariaLabel = `${k + 1}: ${title}`;
      button.addEventListener('click', () => this.open(this.shown === k + 1 ? 0 : k + 1));
      return button;
    });
    $('notes').append(...this.buttons);
    $('close').addEventListener('click', () => this.open(0));
    document.addEventListener('keydown', ({ key }) => key === 'Escape' && this.open(0));
  }

  /** Open the one after the open one. */
  next() {
    if (this.listed.length) this.open((this.shown % this.listed.length) + 1);
  }

  /** Open one by its number and move to it, unless `stays`; 0 closes. */
  open(number, stays = false) {
    const note = this.listed[number - 1];
    const hadFocus = $('note').contains(document.activeElement);
    if (hadFocus && !note) this.buttons[this.shown - 1].focus();
    this.shown = note ? number : 0;
    this.buttons.forEach((button, k) => (button.ariaExpanded = k + 1 === number));
    $('note').hidden = !note;
    if (note) {
      $('title').textContent = note.title;
      $('text').textContent = note.text;
      if (!stays) this.#approach(note);
    }
    this.changed();
  }

  /** Fly to the view of an annotation, or turn to its point. */
  #approach({ position, view }) {
    const { viewer } = this;
    if (viewer.views[view]) return viewer.fly(viewer.poseOf(view), view);
    const { eye, turn } = viewer.pose;
    const pose = Pose.facing(eye, position, turn[1].map((value) => -value));
    if (pose) viewer.fly(pose);
  }

  /** Put the numbers where a camera sees the points; the lens is in pixels of the page. */
  place({ eye, turn }, { focal, centre, size, near }) {
    this.listed.forEach(({ position }, k) => {
      const away = plus(position, eye, -1);
      const depth = dot(turn[2], away);
      const at = [0, 1].map((axis) => (focal[axis] * dot(turn[axis], away)) / depth + centre[axis]);
      const isSeen = depth > near && at.every((value, axis) => value >= 0 && value <= size[axis]);
      const { style } = this.buttons[k];
      style.visibility = isSeen ? '' : 'hidden';
      if (isSeen) style.translate = `${at[0]}px ${at[1]}px`;
    });
  }
}
