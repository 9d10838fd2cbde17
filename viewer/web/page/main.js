// The page: one scene, or two to compare.
import { SourceError } from '../src/index.js';
import { control } from './controls.js';
import { Loaded } from './loaded.js';
import { REST, Pace } from './pace.js';
import { Panel } from './panel.js';
import { Pose } from './pose.js';
import { Renderer } from './renderer.js';

const BACKGROUNDS = { black: [0, 0, 0], grey: [0.5, 0.5, 0.5], white: [1, 1, 1] };

/** The up axis that cameras say; views are shown as these were. */
const BY_CAMERAS = 'cameras';

/** Gaussians of scenes with levels that this device holds at once, unless another number is given. */
function defaultBudget() {
  if (matchMedia('(pointer: coarse)').matches) return 1e6;
  return (navigator.deviceMemory ?? 4) >= 8 ? 3e6 : 1.5e6;
}

class Viewer {
  constructor({ scenes, views, home, middle, ups, up }) {
    this.views = views;
    this.home = home; // the number of the view that is an overview
    this.middle = middle;
    this.ups = ups; // vectors by name, the cameras' first
    this.axis = up;
    this.canvas = document.getElementById('view');
    this.abort = new AbortController();
    this.pace = new Pace();
    this.shrink = null; // by what the sides of the last picture were divided
    this.isSaving = false;
    this.failures = []; // of the device
    this.look = { show: 'a', split: 0.5, degree: 3, background: 'black' };
    this.budget = defaultBudget();
    this.panel = new Panel(this, scenes);
    this.scenes = scenes.map((entry) => new Loaded(entry, () => this.#arrived()));
    this.choose(0);
    this.panel.upright(this.axis);
    control(this.canvas, this);
    new ResizeObserver(() => this.redraw()).observe(this.canvas);
    this.canvas.addEventListener('webglcontextlost', () =>
      this.#fail(new Error('the graphics card was lost: reload the page')),
    );
  }

  async run() {
    try {
      this.renderer = new Renderer(this.canvas);
    } catch (error) {
      this.#fail(error);
      this.panel.loaded();
      document.body.dataset.state = 'error';
      return;
    }
    this.redraw();
    this.abort.signal.addEventListener('abort', () => this.#tell());
    await this.#load();
  }

  /** Load what is not there yet. */
  async #load() {
    const { signal } = this.abort;
    const missing = this.scenes.filter(({ isLoaded }) => !isLoaded);
    this.isLoaded = missing.length === 0;
    await Promise.all(
      missing.map((scene) => scene.load(this.renderer.gl, signal, () => this.#share)),
    );
    this.panel.loaded();
    this.isLoaded = true;
    this.#arrived();
  }

  /** Ask once more for what connections have lost. */
  retry() {
    for (const { detail } of this.scenes) detail?.retry();
    if (this.isLoaded) this.#load();
  }

  #fail(error) {
    this.failures.push(error);
    this.#tell();
  }

  /** What could not be had, and what to say of it. */
  get #errors() {
    const ofScenes = this.scenes.flatMap((scene) =>
      scene.errors.map((error) => ({ text: scene.told(error), error })),
    );
    return [...this.failures.map((error) => ({ text: error.message, error })), ...ofScenes];
  }

  /** Say what is wrong, or that nothing is. */
  #tell() {
    const errors = this.#errors;
    const isStopped = this.abort.signal.aborted;
    const lost = this.scenes.find((scene) => scene.lost);
    let text = [...new Set(errors.map((one) => one.text))].join('\n');
    if (!text && isStopped) text = 'Stopped: the page shows what was loaded.';
    else if (!text && lost) text = `${lost.told(lost.lost)}: asking again`;
    const mayRetry = !isStopped && errors.some(({ error }) => error instanceof SourceError);
    this.panel.tell(text, errors.length > 0, mayRetry);
  }

  /** The share of the budget that a scene with levels has. */
  get #share() {
    return this.budget / this.scenes.filter(({ entry }) => entry.levels).length;
  }

  /** Hold so many Gaussians of scenes with levels on the graphics card. */
  resize(budget) {
    this.budget = budget;
    try {
      for (const { detail } of this.scenes) detail?.resize(this.#share);
    } catch (error) {
      this.#fail(error);
    }
    this.redraw();
  }

  #arrived() {
    if (!this.isLoaded) this.panel.progress(this.scenes); // orders come later, too
    this.panel.detailed(this.scenes, this.abort.signal.aborted);
    this.#tell();
    this.redraw();
  }

  /** Go to a view by its number. */
  choose(index) {
    const count = this.views.length;
    this.view = ((index % count) + count) % count;
    this.pose = Pose.of(this.views[this.view], this.middle);
    if (this.axis !== BY_CAMERAS) this.pose.roll(this.up);
    this.panel.chosen(this.view);
    this.redraw();
  }

  /** What is up, of length 1. */
  get up() {
    return this.ups[this.axis];
  }

  /** Take another axis for up, by its name, and roll the picture upright. */
  setUp(axis) {
    this.axis = axis;
    this.pose.roll(this.up);
    this.panel.upright(axis);
    this.moved();
  }

  /** The camera has moved, and may go on. */
  moved() {
    this.pace.move();
    this.pose = this.pose.copy(); // scenes know by it which order they are in
    this.redraw();
  }

  /** Show otherwise: `show` (a, b, wipe, error), `split`, `degree`, `background`. */
  set(look) {
    Object.assign(this.look, look);
    this.panel.shown(this.look);
    this.redraw();
  }

  /** Pixels of the page by which a thing as far away as it is large is seen. */
  get focal() {
    const { width, height } = this.canvas;
    return this.#lens(width, height).focal[1] / (this.canvas.width / this.canvas.clientWidth || 1);
  }

  /** The lens of the view, whose frame is all in w x h pixels. */
  #lens(w, h) {
    const { width, height, fx, fy, cx, cy } = this.views[this.view];
    const scale = Math.min(w / width, h / height);
    const aside = [(w - scale * width) / 2, (h - scale * height) / 2];
    return {
      focal: [scale * fx, scale * fy],
      centre: [aside[0] + scale * cx, aside[1] + scale * cy],
      size: [w, h],
    };
  }

  /** Draw soon. */
  redraw() {
    if (!this.renderer) return;
    document.body.dataset.state = 'drawing';
    this.asked ??= requestAnimationFrame(() => this.#drawIfDone());
  }

  /** Draw unless the last picture is not done: on slow devices many would wait. */
  #drawIfDone() {
    const { renderer } = this;
    const lens = this.#lens(...this.#size(1));
    for (const scene of this.scenes) {
      scene.aim(this.pose, lens);
      scene.sort(this.pose);
    }
    // While scenes load, or are refined for a camera at rest, a third of the time is for pictures.
    const isBusy = !this.isLoaded || (this.pace.isResting && !this.#isThere);
    const isTime = !isBusy || renderer.rested > 2 * renderer.took;
    if (renderer.isDone() && isTime && this.scenes.every((scene) => scene.isNearlyInOrder)) {
      this.asked = undefined;
      this.#draw();
    } else {
      this.asked = requestAnimationFrame(() => this.#drawIfDone());
    }
  }

  /** Whether all that the view needs is there. */
  get #isThere() {
    return this.isLoaded && this.scenes.every(({ isComplete }) => isComplete);
  }

  /** By what to divide the sides of the next picture: what is saved or compared is never a draft. */
  get #shrink() {
    const isCompared = this.look.show === 'wipe' || this.look.show === 'error';
    return this.isSaving || isCompared ? 1 : this.pace.shrink;
  }

  /** Pixels of a picture, by what its sides are divided. */
  #size(shrink) {
    const dots = Math.min(globalThis.devicePixelRatio || 1, 2) / shrink;
    const { clientWidth, clientHeight } = this.canvas;
    return [clientWidth, clientHeight].map((side) => Math.max(1, Math.round(side * dots)));
  }

  /** Give the canvas its size. */
  #resize() {
    const { canvas } = this;
    const [width, height] = this.#size(this.shrink);
    // To set it clears the picture.
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
  }

  #draw() {
    const { renderer, scenes, pose, look } = this;
    if (this.shrink === 1) this.pace.took(renderer.took);
    this.shrink = this.#shrink;
    this.#resize();
    renderer.draw(scenes, pose, this.#lens(this.canvas.width, this.canvas.height), {
      degree: look.degree,
      background: BACKGROUNDS[look.background],
      split: { a: 1, b: 0, wipe: look.split, error: 1 }[look.show],
      errors: look.show === 'error',
    });
    for (const { detail } of scenes) detail?.pictured();
    if (this.shrink > 1) this.#sharpen();
    else if (this.isSaving) this.#download();
    const inOrder = this.shrink === 1 && scenes.every((scene) => scene.isInOrder(pose));
    const state = !inOrder ? 'drawing' : this.#isThere ? 'ready' : 'loading';
    document.body.dataset.state = state === 'ready' && this.#errors.length ? 'error' : state;
  }

  /** Draw in full when the camera rests. */
  #sharpen() {
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.redraw(), REST);
  }

  /** Save the picture, after it has been drawn in full. */
  save() {
    this.isSaving = true;
    this.redraw();
  }

  #download() {
    this.isSaving = false;
    this.canvas.toBlob((blob) => {
      const link = document.createElement('a');
      link.href = URL.createObjectURL(blob);
      link.download = `${document.title.replace(/[^\w.-]+/g, '_')}.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    });
  }
}

// On telephones, and in pages of others, there is no room for both.
document.getElementById('panel').open = innerWidth > (self === top ? 560 : 1000);
new Viewer(JSON.parse(document.getElementById('scene-list').textContent)).run();
