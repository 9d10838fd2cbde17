// Plays a sequence, decoded ahead, and the bar below the picture.
import { SourceError } from '../src/index.js';
import { AGAIN } from './detail.js';
import { number, say } from './strings.js';

const $ = (id) => document.getElementById(id);

/** Seconds that are decoded ahead, and the longest time that a picture may be late. */
const [AHEAD, LATE] = [0.5, 0.25];

const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

export class Player {
  #queue = []; // frames decoded ahead
  #run = 0; // number of the current decoding, which a jump replaces
  #target = null; // frame of a jump that is being decoded
  #hasFailed = false; // decoding, since the last jump
  #held = false; // the slider, by a pointer
  #room; // continues decoding when the queue has room

  /**
   * @param {Sequence} sequence
   * @param {object} stage shows frames: `prepare(scene)` uploads a key frame, `begin(scene, splats)`
   *   shows it, `move(scene, changes)` changes it, `drop(splats)` frees one that is not shown;
   *   `stopped(error)`, and `changed()` if another frame is shown, or it plays or pauses
   */
  constructor(sequence, stage) {
    this.sequence = sequence;
    this.stage = stage;
    this.shown = null; // number of the frame
    this.wanted = 0;
    this.isPlaying = false;
    $('bar').hidden = false;
    $('time').max = sequence.count - 1;
    $('play').addEventListener('click', () => this.play(!this.isPlaying));
    $('time').addEventListener('input', () => {
      this.#held = true;
      this.seek(Number($('time').value));
    });
    // Without `change` if it is back where it was.
    for (const name of ['change', 'pointerup', 'lostpointercapture']) {
      $('time').addEventListener(name, () => {
        this.#held = false;
        this.#tell();
      });
    }
    this.#tell();
  }

  /** Play, or pause. */
  play(isOn) {
    this.isPlaying = isOn && this.sequence.count > 1;
    this.#tell();
    this.stage.changed();
    let last = performance.now();
    let due = 0;
    const next = (now) => {
      if (this.next !== next) return;
      due += Math.min((now - last) / 1000, LATE) * this.sequence.fps;
      last = now;
      const isReady = !this.#held && this.#target === null;
      while (due >= 1) due = isReady && this.#step() ? due - 1 : 0;
      requestAnimationFrame(next);
    };
    this.next = this.isPlaying && next;
    if (this.isPlaying) requestAnimationFrame(next);
  }

  /** Pause, and go some frames on or back. */
  step(frames) {
    const { count } = this.sequence;
    this.play(false);
    this.seek((this.wanted + frames + count) % count);
  }

  /** Whether frames on the way to another are being decoded. */
  get isJumping() {
    return this.#target !== null;
  }

  /** Show a frame, after those that are needed for it. */
  seek(frame) {
    this.wanted = frame;
    if (this.#target !== null || frame === this.shown) return;
    this.#target = frame;
    document.body.dataset.state = 'drawing';
    const { sequence, shown } = this;
    const group = sequence.groupOf(frame);
    const isAfter = shown !== null && shown < frame && sequence.groupOf(shown) === group;
    if (isAfter && !this.#hasFailed) this.#advance();
    else this.#decode(group);
  }

  /** Number of the frame that is asked for, or shown if that failed. */
  get frame() {
    return this.#hasFailed ? (this.shown ?? this.wanted) : this.wanted;
  }

  /** Continue after an error. */
  retry() {
    this.#decode(this.sequence.groupOf((this.#target = this.wanted)));
  }

  /** Decode from a group on, again and again, half a second ahead. */
  async #decode(first) {
    const { sequence, stage } = this;
    const run = ++this.#run;
    this.#hasFailed = false;
    const isOver = () => run !== this.#run;
    for (const { splats } of this.#queue.splice(0)) stage.drop(splats);
    this.#room?.();
    const ahead = Math.max(AHEAD * sequence.fps, 2);
    const room = async (isFull) => {
      while (isFull() && !isOver()) await new Promise((resolve) => (this.#room = resolve));
    };
    const push = async (item) => {
      if (isOver()) return stage.drop(item.splats);
      this.#queue.push(item);
      if (this.#target !== null) this.#advance();
      await room(() => this.#queue.length >= ahead);
    };
    const { length } = sequence.keys;
    try {
      for (let number = first; !isOver(); number = (number + 1) % length) {
        const group = await this.#open(number);
        if (length > 1) sequence.fetch((number + 1) % length);
        try {
          const { scene } = group;
          const splats = await stage.prepare(scene);
          await push({ frame: group.frame, scene, splats });
          while (!isOver() && group.frame < group.end - 1) {
            const changes = await group.next();
            await push({ frame: group.frame, scene, changes });
          }
        } finally {
          group.close();
        }
        if (sequence.count === 1) return;
        // At most one group is in memory beside the shown one.
        await room(() => this.#queue.some(({ splats }) => splats));
      }
    } catch (error) {
      if (isOver()) return;
      this.#hasFailed = true;
      this.#target = null;
      this.#tell();
      stage.stopped(error);
    }
  }

  /** Open a group; again after lost connections. */
  async #open(number) {
    for (const wait of AGAIN) {
      try {
        return await this.sequence.group(number);
      } catch (error) {
        if (!(error instanceof SourceError)) throw error;
        await pause(wait);
      }
    }
    return this.sequence.group(number);
  }

  /** Show the next decoded frame; false if there is none. */
  #step() {
    const item = this.#queue.shift();
    if (!item) return false;
    const { frame, scene, splats, changes } = item;
    if (splats) this.stage.begin(scene, splats);
    else this.stage.move(scene, changes);
    this.#room?.();
    this.shown = frame;
    if (!this.isJumping) this.wanted = frame;
    this.#tell();
    this.stage.changed();
    return true;
  }

  /** Go on to the frame of a jump, if it is decoded, and then to one wanted since. */
  #advance() {
    while (this.shown !== this.#target && this.#step());
    if (this.shown !== this.#target) return;
    this.#target = null;
    this.seek(this.wanted);
  }

  #tell() {
    const { count, fps } = this.sequence;
    const seconds = (frames) => number(frames / fps, 2);
    $('play').textContent = this.isPlaying ? '❚❚' : '▶';
    $('play').ariaLabel = say(this.isPlaying ? 'Pause' : 'Play');
    $('clock').textContent = `${seconds(this.shown ?? 0)} / ${seconds(count)} s`;
    if (!this.#held) $('time').value = this.frame;
    $('time').ariaValueText = `${this.shown ?? 0}: ${$('clock').textContent}`;
  }
}
