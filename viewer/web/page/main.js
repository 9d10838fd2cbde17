// The page: one scene, or two to compare.
// First: the text of its workers compresses better next to the same code for this thread.
import { Loaded } from './loaded.js';
import { SourceError } from '../src/index.js';
import { accompany } from './access.js';
import { addressOf, stateOf } from './address.js';
import { Annotations } from './annotations.js';
import { control } from './controls.js';
import { answer } from './embedded.js';
import { Headset } from './headset.js';
import { joystick } from './joystick.js';
import { NEAR } from './limits.js';
import { REST, Pace } from './pace.js';
import { Panel } from './panel.js';
import { Pose } from './pose.js';
import { Renderer } from './renderer.js';
import { LANGUAGE, LANGUAGES, say } from './strings.js';
import { Tour, eased } from './tour.js';

/** Radians per second of a picture that turns by itself. */
const TURN = 0.25;

/** Seconds of a flight to another pose. */
const FLIGHT = 1.2;

/** Milliseconds without a change after which the address tells what is shown. */
const SETTLED = 400;

const BACKGROUNDS = { black: [0, 0, 0], grey: [0.5, 0.5, 0.5], white: [1, 1, 1] };

/** Name of the up axis given by the cameras; views are then shown as captured. */
const BY_CAMERAS = 'cameras';

/** Whether the device is a phone or a tablet. */
const isTouched = () => matchMedia('(pointer: coarse)').matches;

/** Maximum bytes of decoded floats of scenes without levels on this device. */
function memoryLimit() {
  return isTouched() ? 2 ** 26 * Math.min(navigator.deviceMemory ?? 4, 4) : undefined;
}

/** Default maximum number of Gaussians of scenes with levels on this device. */
function defaultBudget() {
  if (isTouched()) return 1e6;
  return (navigator.deviceMemory ?? 4) >= 8 ? 3e6 : 1.5e6;
}

class Viewer extends EventTarget {
  constructor({ scenes, views, home, middle, ups, up, annotations = [], tour, embed }) {
    super();
    this.views = views;
    this.home = home; // number of the overview
    this.middle = middle;
    this.ups = ups; // vectors by name, the cameras' first
    this.axis = up;
    this.path = tour; // cameras with times
    this.note = ''; // a text to show
    this.frame = null; // the lens, if not that of the view
    this.canvas = document.getElementById('view');
    this.abort = new AbortController();
    this.pace = new Pace();
    this.shrink = null; // divisor of the last picture's sides
    this.takers = []; // what waits for a picture drawn in full: functions, each with the pose then
    this.failures = []; // of the device
    this.look = { show: 'a', split: 0.5, degree: 3, background: 'black' };
    this.budget = defaultBudget();
    this.panel = new Panel(this, scenes);
    const most = memoryLimit() && memoryLimit() / scenes.length;
    this.scenes = scenes.map((entry) => new Loaded(entry, () => this.#arrived(), most));
    this.notes = new Annotations(this, annotations, () => this.#remember());
    this.choose(0);
    this.panel.upright(this.axis);
    this.#restore();
    addEventListener('hashchange', () => {
      this.#restore();
      // The address may leave out what is kept.
      this.remembered = location.hash.slice(1);
      this.#remember();
    });
    answer(this, embed);
    accompany(this);
    joystick(document.getElementById('stick'), control(this.canvas, this));
    new ResizeObserver(() => this.redraw()).observe(this.canvas);
    this.canvas.addEventListener('webglcontextlost', () =>
      this.#fail(new Error(say('the graphics card was lost: reload the page'))),
    );
  }

  async run() {
    try {
      this.renderer = new Renderer(this.canvas);
    } catch (error) {
      this.#fail(error);
      this.#ended();
      document.body.dataset.state = 'error';
      return;
    }
    this.redraw();
    this.abort.signal.addEventListener('abort', () => this.#tell());
    await this.#load();
  }

  /** Load everything that is missing. */
  async #load() {
    const { signal } = this.abort;
    const missing = this.scenes.filter(({ isLoaded }) => !isLoaded);
    this.isLoaded = missing.length === 0;
    await Promise.all(
      missing.map((scene) => scene.load(this.renderer.gl, signal, () => this.#share)),
    );
    this.#ended();
    this.isLoaded = true;
    this.#arrived();
  }

  #ended() {
    this.panel.loaded();
    this.dispatchEvent(new Event('ended'));
  }

  /** Retry what connections lost. */
  retry() {
    for (const scene of this.scenes) {
      scene.detail?.retry();
      if (scene.player && scene.failures.splice(0).length) scene.player.retry();
    }
    if (this.isLoaded) this.#load();
  }

  #fail(error) {
    this.failures.push(error);
    this.#tell();
  }

  /** Current failures, as messages. */
  get errors() {
    const ofScenes = this.scenes.flatMap((scene) =>
      scene.errors.map((error) => ({ text: scene.told(error), error })),
    );
    return [...this.failures.map((error) => ({ text: error.message, error })), ...ofScenes];
  }

  /** Show the current failures, or clear the message. */
  #tell() {
    const errors = this.errors;
    const isStopped = this.abort.signal.aborted;
    const lost = this.scenes.find((scene) => scene.lost);
    let text = [...new Set(errors.map((one) => one.text))].join('\n');
    if (!text && isStopped) text = say('Stopped: the page shows what was loaded.');
    else if (!text && lost) text = say('{}: retrying', lost.told(lost.lost));
    else if (!text) text = this.note;
    const mayRetry = !isStopped && errors.some(({ error }) => error instanceof SourceError);
    this.panel.tell(text, errors.length > 0, mayRetry);
  }

  /** Leave a text on the page until the camera is moved, unless there are failures. */
  #leave(text) {
    this.note = text;
    this.#tell();
  }

  /** A scene's share of the budget, if it has levels. */
  get #share() {
    return this.budget / this.scenes.filter(({ entry }) => entry.levels).length;
  }

  /** Set the maximum number of Gaussians of scenes with levels on the graphics card. */
  resize(budget) {
    this.budget = budget;
    try {
      for (const { detail } of this.scenes) detail?.resize(this.#share);
    } catch (error) {
      this.#fail(error);
    }
    this.redraw();
  }

  /** What plays a sequence, once it is open. */
  get player() {
    return this.scenes?.[0].player;
  }

  #arrived() {
    if (!this.isLoaded) this.panel.progress(this.scenes); // orders arrive later, too
    this.panel.detailed(this.scenes, this.abort.signal.aborted);
    this.#tell();
    this.redraw();
    if (this.player && !this.player.isPlaying) this.#remember();
  }

  /** Go to a view, by its number. */
  choose(index) {
    const count = this.views.length;
    if (!this.isTurning) this.rest();
    this.view = ((index % count) + count) % count;
    this.pose = this.poseOf(this.view);
    this.hasMoved = false;
    this.panel.chosen(this.view);
    this.redraw();
    this.#remember();
  }

  /** The pose of a view, upright if another axis than that of the cameras is up. */
  poseOf(index) {
    const pose = Pose.of(this.views[index], this.middle);
    if (this.axis !== BY_CAMERAS) pose.roll(this.up);
    return pose;
  }

  /** The up axis, of length 1. */
  get up() {
    return this.ups[this.axis];
  }

  /** Set the up axis, by its name, and roll the picture upright. */
  setUp(axis) {
    this.axis = axis;
    this.isTurned = true;
    this.pose.roll(this.up);
    this.panel.upright(axis);
    this.moved();
  }

  /** Record that the camera has moved, and may move again. */
  moved() {
    this.pace.move();
    this.pose = this.pose.copy(); // a new object, by which scenes know what they are sorted for
    this.hasMoved = true;
    this.redraw();
    this.#remember();
  }

  /** Change display settings: `show` (a, b, wipe, error), `split`, `degree`, `background`. */
  set(look) {
    Object.assign(this.look, look);
    this.panel.shown(this.look);
    this.redraw();
    this.#remember();
  }

  /** Turn the picture slowly about its target, or stop. */
  turn(isOn) {
    if (!isOn) return this.rest();
    this.#play('turn', (seconds) => this.pose.orbit(TURN * seconds, 0, this.up));
  }

  /** Fly to a pose, of a view if it has one; at once if the system asks for reduced motion. */
  fly(pose, view) {
    const from = this.pose;
    let share = matchMedia('(prefers-reduced-motion)').matches ? 1 : 0;
    if (view !== undefined) this.passed(view);
    this.#play('flight', (seconds) => {
      share = Math.min(share + seconds / FLIGHT, 1);
      this.pose = from.towards(pose, eased(share));
      return share < 1;
    });
  }

  /** Go on a tour, or stop. */
  tour(isOn) {
    if (!isOn) return this.rest();
    this.#play('tour', new Tour(this, this.path).begin());
  }

  /** Take the lens of a view from now on. */
  passed(view) {
    this.view = view;
    this.panel.chosen(view);
  }

  /** Whether the picture turns by itself. */
  get isTurning() {
    return this.motion === 'turn';
  }

  /** Stop what moves the camera by itself. */
  rest() {
    if (this.note) this.#leave('');
    if (this.motion) this.#play();
  }

  /** Let `step` move the camera, by seconds, until it returns false or the scene is touched. */
  #play(motion, step) {
    this.motion = motion;
    this.frame = null;
    this.panel.playing(motion);
    let last = performance.now();
    const next = (now) => {
      if (this.next !== next) return;
      const goesOn = step(Math.min(now - last, 100) / 1000) !== false;
      last = now;
      this.moved();
      if (goesOn) requestAnimationFrame(next);
      else this.rest();
    };
    this.next = motion && next;
    if (motion) requestAnimationFrame(next);
    this.#remember();
  }

  /** Show only the picture, or everything. */
  bare(isOn) {
    document.body.classList.toggle('bare', isOn);
    this.isBare = isOn;
    this.#remember();
  }

  /** Choose an SH degree, which scenes that arrive later keep. */
  limit(degree) {
    this.degree = degree;
    this.set({ degree });
  }

  /** Show the page dark, light, or as the system asks (an empty text). */
  dress(theme) {
    this.theme = theme;
    this.panel.dressed(theme);
    this.#remember();
  }

  /** Show the page in another language, by loading it again. */
  speak(language) {
    this.language = language;
    location.hash = this.#address;
  }

  /** What is shown; `addressOf` puts it into the address. */
  get state() {
    const { view, pose, look, panel, axis, isBare, notes, language, player } = this;
    return {
      view,
      camera: [...pose.eye, ...pose.target, ...pose.top],
      show: panel.two ? look.show : undefined,
      wipe: look.split,
      degree: look.degree,
      up: axis,
      background: look.background,
      turn: this.isTurning,
      tour: this.motion === 'tour',
      bare: Boolean(isBare),
      frame: player && !player.isPlaying ? player.frame : undefined,
      note: notes.shown,
      theme: this.theme,
      lang: language,
    };
  }

  /** What is shown, as the part of the address after '#'. */
  get #address() {
    const { state, hasMoved, degree, isTurned } = this;
    return addressOf({
      ...state,
      camera: hasMoved ? state.camera : undefined,
      degree,
      up: isTurned ? state.up : undefined,
    });
  }

  /** What may be shown; see `stateOf`. */
  get possible() {
    return {
      views: this.views.length,
      shows: this.panel.two ? ['a', 'b', 'wipe', 'error'] : [],
      ups: Object.keys(this.ups),
      backgrounds: Object.keys(BACKGROUNDS),
      notes: this.notes.listed.length,
      frames: this.scenes[0].entry.frames ?? 0,
      languages: Object.keys(LANGUAGES),
    };
  }

  /** Show what the address asks for. */
  #restore() {
    const asked = stateOf(location.hash, this.possible);
    this.language = asked.lang;
    if (asked.lang && asked.lang !== LANGUAGE) return location.reload();
    const { turn = false, bare = false, note = 0, theme = '' } = asked;
    this.show({ ...asked, turn, bare, note, theme });
    clearTimeout(this.settling);
    this.remembered = this.#address;
  }

  /** Show what is asked for (see `stateOf`), but turn only where motion is welcome. */
  show(asked) {
    if (asked.up) this.setUp(asked.up);
    if (asked.view !== undefined) this.choose(asked.view);
    if (asked.camera) {
      this.pose = Pose.stated(asked.camera);
      this.moved();
    }
    if (asked.degree !== undefined) this.limit(asked.degree);
    const { show, background, wipe: split } = asked;
    const look = Object.entries({ show, background, split });
    this.set(Object.fromEntries(look.filter(([, value]) => value !== undefined)));
    const { bare, frame, note, turn, tour, theme } = asked;
    if (theme !== undefined) this.dress(theme);
    if (bare !== undefined) this.bare(bare);
    if (frame !== undefined) this.#hold(frame);
    if (note !== undefined) this.notes.open(note, true);
    const isStill = matchMedia('(prefers-reduced-motion)').matches;
    if (turn !== undefined) this.turn(turn && !isStill);
    if (tour && !isStill) this.tour(true);
    else if (tour === false && this.motion === 'tour') this.rest();
  }

  /** Show a frame of a sequence, paused. */
  #hold(frame) {
    this.scenes[0].start = frame;
    if (!this.player) return;
    this.player.play(false);
    this.player.seek(frame);
  }

  /** Put what is shown into the address, once nothing changes; a page in a notebook has none. */
  #remember() {
    clearTimeout(this.settling);
    this.dispatchEvent(new Event('changed'));
    if (location.protocol === 'about:') return;
    this.settling = setTimeout(() => {
      if (this.#address === this.remembered) return;
      this.remembered = this.#address;
      history.replaceState(null, '', `#${this.remembered}`);
    }, SETTLED);
  }

  /** Copy a link to what is shown; true if that worked. */
  async copyLink() {
    const link = new URL(`#${this.#address}`, location.href).href;
    try {
      await navigator.clipboard.writeText(link);
      return true;
    } catch {
      this.#leave(link); // to copy it by hand
      return false;
    }
  }

  /** Focal length in pixels of the page. */
  get focal() {
    const { width, height } = this.canvas;
    return this.#lens(width, height).focal[1] / (this.canvas.width / this.canvas.clientWidth || 1);
  }

  /** Near plane of the view. */
  get near() {
    return this.views[this.view].near ?? NEAR;
  }

  /** The lens of the view, with its whole frame inside w x h pixels. */
  #lens(w, h) {
    const { width, height, fx, fy, cx, cy } = this.frame ?? this.views[this.view];
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
    if (!this.renderer || this.session) return;
    document.body.dataset.state = 'drawing';
    this.asked ??= requestAnimationFrame(() => this.#drawIfDone());
  }

  /** Draw, unless the last picture is unfinished: on slow devices, pictures would queue up. */
  #drawIfDone() {
    const { renderer } = this;
    const lens = this.#lens(...this.#size(1));
    for (const scene of this.scenes) {
      scene.aim(this.pose, lens);
      scene.sort(this.pose);
    }
    // While scenes load, or are refined for a resting camera, pictures take at most a third of the
    // time.
    const isBusy = !this.isLoaded || (this.pace.isResting && !this.#isThere);
    const isTime = !isBusy || renderer.rested > 2 * renderer.took;
    if (renderer.isDone() && isTime && this.scenes.every((scene) => scene.isNearlyInOrder)) {
      this.asked = undefined;
      this.#draw();
    } else {
      this.asked = requestAnimationFrame(() => this.#drawIfDone());
    }
  }

  /** Whether everything that the view needs is loaded. */
  get #isThere() {
    return this.isLoaded && this.scenes.every(({ isComplete }) => isComplete);
  }

  /** Divisor of the next picture's sides; saved and compared pictures are never drafts. */
  get #shrink() {
    const isCompared = this.look.show === 'wipe' || this.look.show === 'error';
    return this.takers.length > 0 || isCompared ? 1 : this.pace.shrink;
  }

  /** Size of a picture in pixels, given the divisor of its sides. */
  #size(shrink) {
    const dots = Math.min(globalThis.devicePixelRatio || 1, 2) / shrink;
    const { clientWidth, clientHeight } = this.canvas;
    return [clientWidth, clientHeight].map((side) => Math.max(1, Math.round(side * dots)));
  }

  /** Set the canvas size. */
  #resize() {
    const { canvas } = this;
    const [width, height] = this.#size(this.shrink);
    // Setting it clears the picture.
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
  }

  #draw() {
    const { renderer, scenes, pose } = this;
    if (this.shrink === 1) this.pace.took(renderer.took);
    this.shrink = this.#shrink;
    this.#resize();
    this.paint(pose, this.#lens(this.canvas.width, this.canvas.height));
    const lens = this.#lens(this.canvas.clientWidth, this.canvas.clientHeight);
    this.notes.place(pose, { ...lens, near: this.near });
    if (this.shrink > 1) this.#sharpen();
    const inOrder = this.shrink === 1 && scenes.every((scene) => scene.isInOrder(pose));
    const isDrawn = inOrder && !this.player?.isJumping;
    if (this.shrink === 1) this.#pass(isDrawn || this.player?.isPlaying);
    const state = !isDrawn ? 'drawing' : this.#isThere ? 'ready' : 'loading';
    document.body.dataset.state = state === 'ready' && this.errors.length ? 'error' : state;
  }

  /** Pass on the picture; unless it `isDrawn`, only to those for whom the camera moved since. */
  #pass(isDrawn) {
    const isDue = ({ pose }) => isDrawn || pose !== this.pose;
    for (const { take } of this.takers.filter(isDue)) this.canvas.toBlob(take);
    this.takers = this.takers.filter((one) => !isDue(one));
  }

  /** Draw a picture on the canvas or, without a wipe, into another target. */
  paint(pose, lens, target) {
    const { renderer, scenes, look } = this;
    const shown = {
      degree: look.degree,
      background: BACKGROUNDS[look.background],
      split: { a: 1, b: 0, wipe: target ? 1 : look.split, error: 1 }[look.show],
      errors: look.show === 'error',
    };
    for (const scene of scenes) scene.flush();
    renderer.draw(scenes, pose, { ...lens, near: this.near }, shown, target);
    for (const { detail } of scenes) detail?.pictured();
  }

  /** Show the scene in a headset, or stop. */
  async immerse() {
    if (this.session) return this.session.end();
    this.rest();
    try {
      this.session = await Headset.enter(this, (pose) => {
        this.session = undefined;
        this.pose = pose;
        this.moved();
      });
    } catch (error) {
      this.#leave(error.message);
    }
  }

  /** Draw in full when the camera rests. */
  #sharpen() {
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.redraw(), REST);
  }

  /** The picture, drawn in full, as a PNG. */
  picture() {
    return new Promise((take) => {
      this.takers.push({ take, pose: this.pose });
      this.redraw();
    });
  }

  /** Save the picture. */
  async save() {
    const link = document.createElement('a');
    link.href = URL.createObjectURL(await this.picture());
    link.download = `${document.title.replace(/[^\p{L}\p{M}\p{N}_.-]+/gu, '_')}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  }
}

// On phones, and in embedded pages, there is no room for both.
document.getElementById('panel').open = innerWidth > (self === top ? 560 : 1000);
const shown = JSON.parse(document.getElementById('scene-list').textContent);
globalThis.viewer = new Viewer(shown); // for the script that gs-viewer adds
globalThis.viewer.run();
