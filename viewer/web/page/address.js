// What the page shows, as the part of its address after '#', so that a link shows the same.

import { Pose } from './pose.js';

/** Significant digits of numbers; coordinates are then exact to a millionth of their size. */
const DIGITS = 7;

const text = (numbers) => numbers.map((value) => Number(value.toPrecision(DIGITS))).join(',');

/**
 * The part after '#'. Values that a fresh page would show are left out, except the view's number.
 *
 * @param {object} state
 * @param {number} state.view
 * @param {number[]} [state.camera] if it is no longer the view's: eye, target, up in the picture
 * @param {string} [state.show] if there are two scenes
 * @param {number} state.wipe
 * @param {number} [state.degree] if chosen
 * @param {string} [state.up] if chosen
 * @param {string} state.background
 * @param {boolean} state.turn whether the picture turns
 * @param {boolean} state.tour whether a tour goes on
 * @param {boolean} state.bare whether only the picture is shown
 * @param {number} [state.frame] of a sequence that does not play
 * @param {number} [state.note] number of the open annotation
 * @param {string} [state.theme] if chosen
 * @param {string} [state.lang] language, if chosen
 */
export function addressOf(state) {
  const { view, camera, show, wipe, degree, up, background } = state;
  const { turn, tour, bare, frame, note, theme, lang } = state;
  const parts = { view };
  if (camera) parts.camera = text(camera);
  if (show) parts.show = show;
  if (show === 'wipe') parts.wipe = text([wipe]);
  if (degree !== undefined) parts.degree = degree;
  if (up !== undefined) parts.up = up;
  if (background !== 'black') parts.background = background;
  if (turn) parts.turn = 1;
  if (tour) parts.tour = 1;
  if (bare) parts.bare = 1;
  if (frame !== undefined) parts.frame = frame;
  if (note) parts.note = note;
  if (theme) parts.theme = theme;
  if (lang) parts.lang = lang;
  // Commas and minus signs need no escapes.
  return new URLSearchParams(parts).toString().replaceAll('%2C', ',');
}

/** Numbers of a list with `length` of them, all finite; else undefined. */
function numbers(listed, length) {
  const found = listed?.split(',').map((value) => (value.trim() ? Number(value) : NaN));
  return found?.length === length && found.every(Number.isFinite) ? found : undefined;
}

/**
 * What an address asks for; whatever is missing or not possible is undefined.
 *
 * @param {string | object} hash or what it would contain, by name
 * @param {object} possible names and numbers: `views`, `shows`, `ups`, `backgrounds`,
 *   `notes`, `frames`, `languages`
 */
export function stateOf(hash, { views, shows, ups, backgrounds, notes, frames, languages }) {
  const asked = new URLSearchParams(typeof hash === 'string' ? hash.replace(/^#/, '') : hash);
  const one = (name, known) => (known.includes(asked.get(name)) ? asked.get(name) : undefined);
  const whole = (name, end) => {
    const [value] = numbers(asked.get(name), 1) ?? [];
    return Number.isInteger(value) && value >= 0 && value < end ? value : undefined;
  };
  const isOn = (name) => {
    const found = one(name, ['0', '1', 'false', 'true']);
    return found && (found === '1' || found === 'true');
  };
  const [wipe] = numbers(asked.get('wipe'), 1) ?? [];
  const camera = numbers(asked.get('camera'), 9);
  return {
    view: whole('view', views),
    camera: camera && Pose.stated(camera) ? camera : undefined,
    show: one('show', shows),
    wipe: wipe >= 0 && wipe <= 1 ? wipe : undefined,
    degree: whole('degree', 4),
    up: one('up', ups),
    background: one('background', backgrounds),
    turn: isOn('turn'),
    tour: isOn('tour'),
    bare: isOn('bare'),
    frame: whole('frame', frames),
    note: whole('note', notes + 1),
    theme: one('theme', ['dark', 'light', '']),
    lang: one('lang', languages),
  };
}
