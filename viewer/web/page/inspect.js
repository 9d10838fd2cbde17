// The window's inspection, in a page that gs-viewer serves: its server draws layers, and encodes.
import { INSPECTED } from './inspect_words.js';
import { slide } from './line.js';
import { REST } from './pace.js';
import { WORDS, number, say, sizeText } from './strings.js';

Object.assign(WORDS, INSPECTED);

const LAYERS = ['splats', 'centres', 'pruned', 'boxes', 'octree', 'error'];
const COLOURINGS = ['colour', 'opacity', 'scale', 'error', 'bits', 'sh', 'class', 'block'];
const WISHES = {
  steps: 'steps, times the profile’s',
  size: 'size, MB',
  bits: 'bits per Gaussian',
  loss: 'loss of views, dB',
};
const GREYS = { black: 0, grey: 0.5, white: 1 };

/** Maximum side of a picture, pixels. */
const MOST = 1600;

/** Milliseconds between questions about an encoding that runs. */
const OFTEN = 500;

/** Number of steps of the slider of rates. */
const STEPS = 200;

/** Milliseconds until a picture is asked for again that another page has asked for. */
const AGAIN = 1000;

/** Maximum bytes of a dropped file; as on the server. */
const MOST_DROPPED = 2 ** 31;

const STYLE = `
  #layers { position: fixed; inset: 0; pointer-events: none; }
  #inspect > * { margin: 6px 0; }
  #inspect label { display: flex; justify-content: space-between; align-items: center; gap: 8px; }
  #inspect .layers label { display: inline-flex; }
  #inspect select { min-width: 0; }
  #inspect :disabled { opacity: 0.5; }
  #inspect input[type='range'] { flex: 1; min-width: 0; }
  #inspect output { min-width: 4em; text-align: right; font-variant-numeric: tabular-nums; }
  #inspect p:empty, #inspect ul:empty { display: none; }
  #inspect p { margin: 6px 0 0; overflow-wrap: anywhere; }
  #inspect .row { display: flex; gap: 6px; }
  #inspect .scale { display: grid; grid-auto-flow: column; grid-auto-columns: 1fr; text-align: center; font-size: 12px; }
  #inspect .scale.blends :first-child { text-align: left; }
  #inspect .scale.blends :last-child { text-align: right; }
  #inspect .colours { height: 10px; }
  #inspect .colours + .scale { margin-top: 0; }
  #inspect .reason { display: inline-block; width: 10px; height: 10px; margin-inline-end: 6px; }
  #cut::before { content: attr(data-left); white-space: nowrap; }
  #cut::after { content: none; }
  #inspect li + li { margin-top: 6px; }
  @media (pointer: coarse) { #inspect input[type='range'], #inspect label { min-height: 44px; } }
`;

const { viewer } = globalThis;
const $ = (id) => document.getElementById(id);

/** Number of the trial encoding that is B, or 0. */
const trial = Number(new URLSearchParams(location.search).get('b') ?? 0);

function make(name, parent, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  parent?.append(made);
  return made;
}

/** The server's answer; undefined if a newer question replaces this one. */
async function ask(call, value = {}, signal = undefined) {
  const body = JSON.stringify({ call, ...value });
  const asked = fetch($('inspection').dataset.calls, { method: 'POST', body, signal });
  const answer = await asked.catch((error) => {
    if (signal?.aborted) throw error;
    throw new Error(say('the server does not answer'));
  });
  if (answer.status === 404) throw new Error(say('a file was dropped on another page; reload this one'));
  if (answer.status === 409) return undefined;
  if (!answer.ok) throw new Error(await answer.text());
  return answer;
}

/** A picture, and what the server says about it. */
async function askForPicture(call, value, signal) {
  const answer = await ask(call, value, signal);
  if (!answer) return undefined;
  const facts = JSON.parse(answer.headers.get('Facts') ?? '{}');
  return { facts, bitmap: await createImageBitmap(await answer.blob()) };
}

const section = make('details', null, { id: 'inspect' });
make('summary', section, { textContent: say('Inspect') });
const layers = make('canvas', null, { id: 'layers', hidden: true });
const cut = make('div', null, { id: 'cut', className: 'line', tabIndex: 0, hidden: true });

class Inspection {
  #kept = { view: '', settings: '', pictures: [] };
  #photographs = new Map();
  #place = 0.5;

  constructor(facts) {
    this.facts = facts;
    this.layers = layers.getContext('2d');
    const isThere = { pruned: facts.pruned, error: viewer.panel.two };
    this.possible = LAYERS.filter((name) => isThere[name] ?? true);
    const { layers: first, colouring, depth, cells } = facts;
    const scale = facts.scale ?? '';
    this.choice = { layers: first, colouring, scale, depth, cells, photograph: '' };
    Object.assign(this.choice, JSON.parse(sessionStorage.getItem(location.pathname)));
    this.choice.layers = this.choice.layers.filter((name) => this.possible.includes(name));
    if (viewer.look.show === 'wipe') this.choice.photograph = ''; // one line is enough
    this.#addLayers();
    if (facts.photographs) this.#addPhotographs();
    this.told = make('p', section, { role: 'status' });
    this.legends = make('div', section);
    this.rates = new Rates(facts);
    this.#show();
    viewer.addEventListener('changed', () => this.changed());
    new ResizeObserver(() => this.changed()).observe(viewer.canvas);
    const own = viewer.picture.bind(viewer);
    viewer.picture = async () => this.#over(await own());
  }

  #addLayers() {
    const group = make('fieldset', section, { className: 'layers' });
    make('legend', group, { textContent: say('Layers') });
    this.boxes = this.possible.map((value) => {
      const box = make('input', null, { type: 'checkbox', value });
      make('label', group, {}, box, ` ${say(value)}`);
      return box;
    });
    group.addEventListener('change', ({ target: { value, checked } }) => {
      const chosen = this.boxes.filter((box) => box.checked).map((box) => box.value);
      if (value === 'error' && checked && viewer.look.show === 'a') viewer.set({ show: 'b' });
      this.#choose({ layers: chosen });
    });
    const list = (name, text, values) => {
      const label = make('label', section, {}, `${say(text)} `);
      const control = make('select', label);
      for (const value of values) control.add(new Option(say(value || 'automatic'), value));
      control.addEventListener('change', () => this.#choose({ [name]: control.value }));
      return { label, control };
    };
    this.lists = {
      colouring: list('colouring', 'Colour of centres', COLOURINGS.filter((name) => name !== 'error' || viewer.panel.two)),
      scale: list('scale', 'Colour scale', ['', 'linear', 'log']),
      cells: list('cells', 'Colour of cells', ['occupancy', 'bits']),
    };
    const label = make('label', section, {}, `${say('Depth')} `);
    const control = make('input', label, { type: 'range', min: 1, max: 12 });
    const value = make('output', label);
    control.addEventListener('input', () => this.#choose({ depth: Number(control.value) }));
    this.depth = { label, control, value };
  }

  #addPhotographs() {
    const label = make('label', section, {}, `${say('Photograph')} `);
    const control = make('select', label);
    for (const [value, text] of [['', 'off'], ['whole', 'over the picture'], ['wipe', 'left of a line']]) {
      control.add(new Option(say(text), value));
    }
    control.addEventListener('change', () => {
      if (control.value && viewer.look.show === 'wipe') viewer.set({ show: 'b' });
      this.#choose({ photograph: control.value });
    });
    this.photograph = control;
    make('i', cut);
    cut.role = 'slider';
    cut.dataset.left = say('photograph');
    cut.ariaLabel = say('Line between photograph and scene');
    slide(cut, () => this.#place, (place) => {
      this.#place = place;
      this.#paint();
    });
  }

  #choose(choice) {
    Object.assign(this.choice, choice);
    sessionStorage.setItem(location.pathname, JSON.stringify(this.choice));
    this.#show();
    this.changed();
  }

  /** Show the choices. */
  #show() {
    const { choice, boxes, lists, depth } = this;
    for (const box of boxes) box.checked = choice.layers.includes(box.value);
    for (const [name, { control }] of Object.entries(lists)) control.value = choice[name];
    const [hasCentres, hasCells] = ['centres', 'octree'].map((name) => choice.layers.includes(name));
    lists.colouring.label.hidden = !hasCentres;
    lists.scale.label.hidden = !hasCentres || !this.#scale.length;
    lists.cells.label.hidden = depth.label.hidden = !hasCells;
    depth.control.value = depth.value.value = choice.depth;
    if (this.photograph) this.photograph.value = choice.photograph;
  }

  /** The scale of colours, in a list; empty for colours without one. */
  get #scale() {
    const { colouring, scale } = this.choice;
    return ['opacity', 'scale', 'error', 'bits', 'sh'].includes(colouring) ? [scale || null] : [];
  }

  /** Whether the server draws: the page draws splats alone itself. */
  get #isDrawn() {
    return this.choice.layers.join() !== 'splats';
  }

  /** Indices of the scenes in the picture. */
  get #scenes() {
    return { a: [0], b: [1], wipe: [0, 1], error: [1] }[viewer.look.show];
  }

  /** Camera, size and colours of the page's picture. */
  get #view() {
    const { width, height, fx, fy, cx, cy } = viewer.frame ?? viewer.views[viewer.view];
    const { eye: position, turn } = viewer.pose;
    const { near } = viewer;
    const rotation = [0, 1, 2].map((axis) => turn.map((row) => row[axis]));
    const camera = { img_name: '', width, height, fx, fy, cx, cy, position, rotation, near };
    const { clientWidth, clientHeight } = viewer.canvas;
    const dots = Math.min(devicePixelRatio || 1, MOST / Math.max(clientWidth, clientHeight));
    const [w, h] = [clientWidth, clientHeight].map((side) => Math.max(1, Math.round(dots * side)));
    const grey = GREYS[viewer.look.background];
    return { camera, w, h, degree: viewer.look.degree, background: [grey, grey, grey] };
  }

  get #settings() {
    const { layers: chosen, colouring, depth, cells } = this.choice;
    const isError = viewer.look.show === 'error' && !chosen.includes('error');
    const [scale = null] = this.#scale;
    const drawn = isError ? [...chosen, 'error'] : chosen;
    return { trial, layers: drawn, colouring, scale, depth, cells };
  }

  /** Update the picture; what the server draws comes when the camera rests. */
  changed() {
    this.#paint();
    clearTimeout(this.waiting);
    const state = JSON.stringify([this.#view, this.#settings, this.#isDrawn, this.#scenes, this.#seen]);
    if (state === this.state) return;
    this.abort?.abort();
    this.waiting = setTimeout(() => this.#fetch(state), REST);
  }

  async #fetch(state) {
    this.state = state;
    const { signal } = (this.abort = new AbortController());
    try {
      if (this.#seen !== undefined) await this.#fetchPhotograph(this.#seen, signal);
      if (this.#isDrawn) await this.#fetchPictures(signal);
      else this.#describe([]);
      if (viewer.panel.two) await this.#measure(signal);
      else this.told.textContent = '';
    } catch (error) {
      if (!signal.aborted) this.told.textContent = error.message;
    }
  }

  async #fetchPictures(signal) {
    const [view, settings, scenes] = [this.#view, this.#settings, this.#scenes];
    const [viewKey, settingsKey] = [view, settings].map((part) => JSON.stringify(part));
    const isSame = this.#kept.view === viewKey && this.#kept.settings === settingsKey;
    const pictures = isSame ? this.#kept.pictures : [];
    this.told.textContent = say('The server draws …');
    for (const scene of scenes) {
      pictures[scene] ??= await askForPicture('picture', { ...view, ...settings, scene }, signal);
      if (!pictures[scene]) this.#again(signal);
    }
    if (signal.aborted) return;
    this.#kept = { view: viewKey, settings: settingsKey, pictures };
    this.told.textContent = '';
    this.#describe(scenes.map((scene) => pictures[scene]?.facts).filter(Boolean));
    this.#paint();
  }

  /** Ask again, because another page has asked in the meantime. */
  #again(signal) {
    setTimeout(() => {
      if (signal.aborted) return;
      this.state = '';
      this.changed();
    }, AGAIN);
  }

  async #measure(signal) {
    const answer = await ask('quality', { ...this.#view, trial }, signal);
    const { text = '' } = answer ? await answer.json() : {};
    if (!signal.aborted) this.told.textContent = say('B against A, this view: {}', text);
  }

  async #fetchPhotograph(view, signal) {
    const { background } = this.#view;
    const key = `${view} ${background}`;
    if (this.#photographs.has(key)) return;
    const found = await askForPicture('photograph', { view, background }, signal);
    if (!found) return this.#again(signal);
    this.#photographs = new Map([...this.#photographs, [key, found.bitmap]].slice(-4));
    this.#paint();
  }

  /** Number of the view whose photograph is shown, if any. */
  get #seen() {
    const isThere = this.choice.photograph && !viewer.hasMoved && viewer.view < viewer.views.length;
    return isThere ? viewer.view : undefined;
  }

  /** Put the server's pictures and the photograph over the page's own picture, as far as known. */
  #paint() {
    const { look, canvas, views } = viewer;
    const scenes = this.#scenes;
    const isKept = this.#isDrawn && this.#kept.view === JSON.stringify(this.#view);
    const pictures = scenes.map((scene) => isKept && this.#kept.pictures[scene]).filter(Boolean);
    const photograph = this.#photographs.get(`${this.#seen} ${this.#view.background}`);
    const isCut = Boolean(photograph) && this.choice.photograph === 'wipe';
    cut.hidden = !isCut;
    cut.style.left = `${100 * this.#place}%`;
    cut.ariaValueNow = Math.round(100 * this.#place);
    layers.hidden = !photograph && pictures.length < scenes.length;
    if (layers.hidden) return;
    const { w, h } = this.#view;
    [layers.width, layers.height] = [w, h];
    const from = (share, draw) => {
      this.layers.save();
      this.layers.beginPath();
      this.layers.rect(...share);
      this.layers.clip();
      draw();
      this.layers.restore();
    };
    const middle = scenes.length > 1 ? look.split * w : 0;
    const parts = scenes.length > 1 ? [[0, 0, middle, h], [middle, 0, w, h]] : [[0, 0, w, h]];
    if (pictures.length === scenes.length) {
      pictures.forEach(({ bitmap }, k) => from(parts[k], () => this.layers.drawImage(bitmap, 0, 0, w, h)));
    }
    if (!photograph) return;
    const { width, height } = views[this.#seen];
    const scale = Math.min(w / width, h / height);
    const [wide, high] = [scale * width, scale * height];
    const place = [(w - wide) / 2, (h - high) / 2, wide, high];
    from([0, 0, isCut ? this.#place * w : w, h], () => this.layers.drawImage(photograph, ...place));
  }

  /** The page's own picture and what lies over it, as a PNG. */
  async #over(own) {
    if (layers.hidden) return own;
    const under = await createImageBitmap(own);
    const canvas = new OffscreenCanvas(under.width, under.height);
    const drawn = canvas.getContext('2d');
    for (const picture of [under, layers]) drawn.drawImage(picture, 0, 0, under.width, under.height);
    return canvas.convertToBlob();
  }

  /** Captions, legends and reasons of the server's pictures. */
  #describe(facts) {
    this.legends.replaceChildren();
    for (const { remark } of facts) make('p', this.legends, { textContent: remark });
    const all = facts.flatMap(({ legends }) => legends).map((legend) => JSON.stringify(legend));
    for (const { title, marks, colours, blends } of [...new Set(all)].map((text) => JSON.parse(text))) {
      make('p', this.legends, { textContent: title });
      const bar = make('div', this.legends, { className: 'colours' });
      const stops = colours.flatMap((colour, k) => [
        `${colour} ${(100 * k) / colours.length}%`,
        `${colour} ${(100 * (k + 1)) / colours.length}%`,
      ]);
      bar.style.background = `linear-gradient(to right, ${blends ? colours : stops})`;
      const scale = make('div', this.legends, { className: `scale${blends ? ' blends' : ''}` });
      for (const mark of marks) make('span', scale, { textContent: mark });
    }
    for (const [text, colour] of facts.flatMap(({ reasons }) => reasons)) {
      const mark = make('span', null, { className: 'reason' });
      mark.style.background = colour;
      make('div', this.legends, {}, mark, text);
    }
  }
}

/** Trial encodings of A: their settings, and the list of them. */
class Rates {
  constructor(facts) {
    this.facts = facts;
    this.values = Object.fromEntries(Object.entries(facts.scales).map(([name, [value]]) => [name, value]));
    const group = make('fieldset', section);
    make('legend', group, { textContent: say('Encode A') });
    const list = (text, values) => {
      const label = make('label', group, {}, `${say(text)} `);
      const control = make('select', label);
      for (const [value, name] of values) control.add(new Option(name, value));
      control.addEventListener('change', () => this.#show());
      return control;
    };
    this.profile = list('Profile', facts.profiles.map((name) => [name, name]));
    this.profile.value = 'm';
    this.wish = list('by', Object.entries(WISHES).map(([name, text]) => [name, say(text)]));
    const label = make('label', group);
    this.slider = make('input', label, { type: 'range', max: STEPS, ariaLabel: say('Rate') });
    this.value = make('output', label);
    this.slider.addEventListener('input', () => {
      const [low, high] = this.#range;
      this.values[this.wish.value] = low * (high / low) ** (this.slider.value / STEPS);
      this.#show();
    });
    this.guided = make('input', null, { type: 'checkbox' });
    make('label', group, {}, `${say('camera-guided')} `, this.guided);
    const row = make('div', group, { className: 'row' });
    const button = (text, call) => {
      const made = make('button', row, { type: 'button', textContent: say(text) });
      made.addEventListener('click', () => this.#ask(call(), text));
      return made;
    };
    this.start = button('Encode', () => ['encode', this.#settings]);
    this.stop = button('Cancel', () => ['cancel']);
    this.progress = make('progress', group, { ariaLabel: say('Encode A') });
    this.told = make('p', group, { role: 'status' });
    this.list = make('ul', section);
    this.#show();
    this.#ask(['progress']);
  }

  get #range() {
    return this.facts.scales[this.wish.value].slice(1);
  }

  get #settings() {
    const [profile, wish] = [this.profile.value, this.wish.value];
    const value = this.values[wish] * (wish === 'size' ? 1e6 : 1);
    return { profile, wish, value, guided: this.guided.checked };
  }

  /** Show the settings; other profiles than `l`, `m` and `s` have no targets. */
  #show() {
    const isStepped = this.facts.stepped.includes(this.profile.value);
    for (const control of [this.wish, this.slider, this.guided]) control.disabled = !isStepped;
    if (this.wish.value === 'loss') this.guided.disabled = this.guided.checked = true;
    const value = this.values[this.wish.value];
    const [low, high] = this.#range;
    this.slider.value = (STEPS * Math.log(value / low)) / Math.log(high / low);
    const text = number(value, Math.max(0, Math.min(3, 2 - Math.floor(Math.log10(value)))));
    this.value.value = this.slider.ariaValueText = text;
  }

  /** Ask the server, and then what runs until nothing does. */
  async #ask([call, value]) {
    clearTimeout(this.waiting);
    try {
      const answer = await ask(call, value);
      const { doing, error, trials } = await answer.json();
      [this.start.disabled, this.stop.disabled] = [false, !doing];
      this.progress.hidden = !doing;
      this.progress.value = doing?.[1] ?? 0;
      this.told.textContent = doing?.[0] ?? error;
      this.#showTrials(trials);
      clearTimeout(this.waiting);
      if (doing) this.waiting = setTimeout(() => this.#ask(['progress']), OFTEN);
    } catch (error) {
      this.told.textContent = error.message;
      this.stop.disabled = this.progress.hidden = true;
    }
  }

  /** List trials, the newest first. */
  #showTrials(trials) {
    const text = JSON.stringify(trials);
    if (text === this.listed) return;
    this.listed = text;
    this.list.replaceChildren();
    for (const { number: k, name, bytes, ratio, bits, readable, ...measured } of trials.toReversed()) {
      const parts = [
        sizeText(bytes),
        `${number(ratio, 1)}x`,
        say('{} bits per Gaussian', number(bits, 1)),
      ];
      const item = make('li', this.list, {}, k === trial ? `B: ${name}` : name);
      make('small', item, { textContent: parts.join(', ') });
      const { views, mean, worst, where } = measured;
      if (views) {
        make('small', item, { textContent: say('mean of {} views: {}', number(views), mean) });
        make('small', item, { textContent: say('worst: {} in {}', worst, where) });
      }
      const row = make('div', item, { className: 'row' });
      if (readable && k !== trial) this.#go(row, 'Show as B', `?b=${k}`);
      const file = { href: `trial-${k}.egs`, download: `${document.title.split('.')[0]}-${k}.egs` };
      const save = make('button', row, { type: 'button', textContent: say('Download') });
      save.addEventListener('click', () => make('a', null, file).click());
    }
    if (trial) this.#go(make('div', make('li', this.list)), this.facts.second ? 'Show the given B' : 'Show A alone', '');
  }

  /** A button that loads the page with another B; the view stays. */
  #go(parent, text, search) {
    const button = make('button', parent, { type: 'button', textContent: say(text) });
    button.addEventListener('click', () => {
      location.href = `${location.pathname}${search}${location.hash}`;
    });
  }
}

async function begin() {
  section.removeEventListener('toggle', begin);
  const told = make('p', section, { role: 'status', textContent: say('The server reads the scene …') });
  try {
    const answer = await ask('facts');
    new Inspection(await answer.json()).changed();
    told.remove();
  } catch (error) {
    told.textContent = error.message;
  }
}

/** Show a dropped file in place of the scenes. */
async function take(file) {
  const tell = (text, isError) => viewer.panel.tell((viewer.note = text), isError);
  try {
    if (file.size > MOST_DROPPED) throw new Error(say('{}: larger than {}', file.name, sizeText(MOST_DROPPED)));
    await file.slice(0, 1).arrayBuffer(); // fails for folders
    tell(say('The server reads the scene …'), false);
    const asked = fetch(encodeURIComponent(file.name), { method: 'PUT', body: file });
    const answer = await asked.catch(() => {
      throw new Error(say('the server does not answer'));
    });
    if (!answer.ok) throw new Error(await answer.text());
    location.href = location.pathname;
  } catch (error) {
    tell(error.message, true);
  }
}

addEventListener('dragover', (event) => event.preventDefault());
addEventListener('drop', (event) => {
  event.preventDefault();
  const [file] = event.dataTransfer.files;
  if (file) take(file);
});

const sheet = new CSSStyleSheet();
sheet.replaceSync(STYLE);
document.adoptedStyleSheets.push(sheet);
viewer.canvas.after(layers);
$('wipe').after(cut);
if (!viewer.possible.frames) $('legend').after(section); // sequences are only played
section.addEventListener('toggle', begin);
if (trial || $('inspection').dataset.open) section.open = true;
