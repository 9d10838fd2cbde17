// The panel next to the picture, and the keys.
import { hasHeadset } from './headset.js';
import { slide } from './line.js';
import { LANGUAGE, LANGUAGES, counted, number, say, sizeText, translate } from './strings.js';

const $ = (id) => document.getElementById(id);

/** Streams of a file, by attribute. */
const ATTRIBUTES = {
  positions: ['geometry', 'low-bits', 'far'],
  'SH-DC': ['sh-dc'],
  'SH-AC': ['sh1', 'sh2', 'sh3'],
  opacity: ['opacity'],
  scaling: ['scaling', 'classes'],
  rotation: ['rotation'],
  levels: ['level'],
};

function element(name, text, parent) {
  const made = document.createElement(name);
  made.textContent = text;
  parent.append(made);
  return made;
}

export class Panel {
  constructor(viewer, entries) {
    translate();
    this.viewer = viewer;
    this.two = entries.length === 2;
    if (this.two) viewer.look.show = 'wipe';
    this.rows = entries.map(({ name }, k) => {
      const item = element('li', (this.two ? `${'AB'[k]}: ` : '') + name, $('scenes'));
      const told = element('small', '', item);
      const bar = element('progress', '', item);
      bar.setAttribute('aria-label', say('{}, loaded', name));
      const detail = element('small', '', item);
      detail.className = 'detail';
      return { told, bar, detail };
    });
    viewer.views.forEach(({ img_name: name }, k) => $('views').add(new Option(`${k}: ${name}`, k)));
    for (const name of Object.keys(viewer.ups)) $('ups').add(new Option(say(name), name));
    for (const [code, name] of Object.entries(LANGUAGES)) $('language').add(new Option(name, code));
    $('language').value = LANGUAGE;
    $('shows').hidden = !this.two;
    $('stop').hidden = false;
    $('budget').parentElement.hidden = !entries.some(({ levels }) => levels);
    $('budget').value = viewer.budget / 1e6;
    this.#listen();
    this.shown(viewer.look);
  }

  #listen() {
    const { viewer } = this;
    $('stop').addEventListener('click', () => viewer.abort.abort());
    $('retry').addEventListener('click', () => viewer.retry());
    $('save').addEventListener('click', () => viewer.save());
    $('link').hidden = $('language').parentElement.hidden = location.protocol === 'about:';
    $('language').addEventListener('change', ({ target }) => viewer.speak(target.value));
    $('link').addEventListener('click', () => this.#copy());
    $('views').addEventListener('change', ({ target }) => viewer.choose(Number(target.value)));
    $('ups').addEventListener('change', ({ target }) => viewer.setUp(target.value));
    $('degree').addEventListener('change', ({ target }) =>
      viewer.limit(Number(target.value)),
    );
    $('background').addEventListener('change', ({ target }) =>
      viewer.set({ background: target.value }),
    );
    $('budget').addEventListener('change', ({ target }) => {
      if (target.value > 0) viewer.resize(1e6 * target.value);
    });
    $('turn').addEventListener('change', ({ target }) => viewer.turn(target.checked));
    $('tour').parentElement.hidden = !viewer.path && viewer.views.length === 1;
    $('tour').addEventListener('change', ({ target }) => viewer.tour(target.checked));
    hasHeadset().then((isThere) => ($('headset').hidden = !isThere));
    $('theme').addEventListener('change', ({ target }) => viewer.dress(target.value));
    $('headset').addEventListener('click', () => viewer.immerse());
    $('full').hidden = !document.fullscreenEnabled;
    $('full').addEventListener('click', () => document.documentElement.requestFullscreen());
    $('shows').addEventListener('change', ({ target }) => viewer.set({ show: target.value }));
    slide($('wipe'), () => viewer.look.split, (split) => viewer.set({ split }));
    document.addEventListener('keydown', (event) => this.#key(event));
  }

  #key(event) {
    const { viewer, two } = this;
    if (event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented) return;
    const { tagName, id, type } = event.target;
    if (tagName === 'SELECT' || id === 'budget') return;
    if (type === 'range' && event.key === 'Home') return; // moves the slider
    const show = (name) => two && viewer.set({ show: name });
    const actions = {
      ',': () => viewer.player?.step(-1),
      '.': () => viewer.player?.step(1),
      n: () => viewer.choose(viewer.view + 1),
      p: () => viewer.choose(viewer.view - 1),
      r: () => viewer.choose(viewer.view),
      home: () => viewer.choose(viewer.home),
      u: () => viewer.setUp(this.#nextUp),
      1: () => show('a'),
      2: () => show('b'),
      3: () => show('wipe'),
      4: () => show('error'),
      f: () => show(viewer.look.show === 'a' ? 'b' : 'a'),
      x: () => viewer.save(),
      c: () => this.#copy(),
      m: () => viewer.notes.next(),
      o: () => viewer.turn(!viewer.isTurning),
      t: () => viewer.tour(viewer.motion !== 'tour'),
      i: () => viewer.bare(!viewer.isBare),
      h: () => {
        $('panel').open = true;
        $('keys').open = !$('keys').open;
      },
    };
    // Elsewhere, Space presses buttons.
    if (id === 'view' || id === 'time' || tagName === 'BODY') {
      actions[' '] = () => viewer.player?.play(!viewer.player.isPlaying);
    }
    const action = actions[event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault(); // Home would scroll the panel
    action();
  }

  async #copy() {
    const button = $('link');
    if (button.hidden || !(await this.viewer.copyLink())) return;
    button.textContent = say('Link copied');
    clearTimeout(this.copied);
    this.copied = setTimeout(() => (button.textContent = say('Copy link')), 2000);
  }

  /** The axis after the current up axis. */
  get #nextUp() {
    const names = Object.keys(this.viewer.ups);
    return names[(names.indexOf(this.viewer.axis) + 1) % names.length];
  }

  /** Show a message below the picture; with `mayRetry`, lost data can be requested again. */
  tell(text, isError, mayRetry) {
    // Writing the same text would make screen readers repeat it.
    if ($('status').textContent !== text) $('status').textContent = text;
    this.message = { text, isError };
    this.viewer.dispatchEvent(new Event('told'));
    $('told').hidden = !text;
    $('told').classList.toggle('error', isError);
    $('retry').hidden = !mayRetry;
  }

  /** Show how the picture moves by itself. */
  playing(motion) {
    $('turn').checked = motion === 'turn';
    $('tour').checked = motion === 'tour';
  }

  /** Show the theme: dark, light, or an empty text for that of the system. */
  dressed(theme) {
    $('theme').value = theme;
    document.documentElement.style.colorScheme = theme;
  }

  /** Show which view is selected. */
  chosen(index) {
    $('views').value = index;
  }

  /** Show which axis is up. */
  upright(axis) {
    $('ups').value = axis;
  }

  /** Show the display settings. */
  shown({ show, split, degree, background }) {
    for (const input of $('shows').querySelectorAll('input')) input.checked = input.value === show;
    $('wipe').hidden = show !== 'wipe';
    $('wipe').style.left = `${100 * split}%`;
    $('wipe').setAttribute('aria-valuenow', Math.round(100 * split));
    $('legend').hidden = show !== 'error';
    $('background').value = background;
    $('degree').value = degree;
  }

  /** Show the loading progress of scenes. */
  progress(scenes) {
    const least = Math.min(...scenes.map(({ share }) => share));
    this.#title(say('Loading: {} %', Math.floor(100 * least)));
    $('stop').hidden = this.viewer.abort.signal.aborted;
    scenes.forEach(({ share, scene, entry, isReduced }, k) => {
      const { told, bar } = this.rows[k];
      bar.value = share;
      bar.hidden = share === 1;
      if (!scene || told.textContent) return;
      const bytes = Object.values(scene.bytes).reduce((sum, size) => sum + size, 0);
      const profile = say('profile {}', scene.profile);
      const parts = [counted(scene.count, 'Gaussian'), say('SH degree {}', scene.degree), sizeText(bytes)];
      if (isReduced) parts.push(say('SH left out to save memory'));
      const encoded = entry.encoded ? [say('encoded for this page')] : [];
      const lost = entry.psnr
        ? [say('views: {} dB against the original', number(entry.psnr, 1))]
        : [];
      told.textContent = [...parts, ...encoded, profile, ...lost].join(', ');
      this.#list(scenes);
    });
  }

  /** Show the loaded detail of scenes with levels, for the current view. */
  detailed(scenes, isStopped) {
    const refined = scenes.filter(({ detail }) => detail?.splats);
    if (refined.length === 0) return;
    scenes.forEach(({ detail, isComplete }, k) => {
      if (!detail?.splats) return;
      const { file, drawn, missing, needed } = detail;
      this.rows[k].bar.value = needed > 0 ? 1 - missing / needed : 0;
      this.rows[k].bar.hidden = isComplete;
      const fetched = say('{} fetched', sizeText(file.fetched));
      this.rows[k].detail.textContent = `${fetched}, ${say('{} drawn', counted(drawn, 'Gaussian'))}`;
    });
    const missing = refined.reduce((sum, { detail }) => sum + detail.missing, 0);
    if (scenes.every(({ share }) => share === 1)) this.#title(say(missing ? 'Refining' : 'Scene'));
    $('stop').hidden = isStopped || scenes.every(({ isComplete }) => isComplete);
    $('refined').textContent =
      missing === 0
        ? ''
        : say(
            '{} of this view missing: picture, comparison and saved picture are coarser there.',
            counted(missing, 'block'),
          );
  }

  /** List bits by attribute, and the available SH degrees. */
  #list(scenes) {
    const known = scenes.map(({ scene }) => scene).filter(Boolean);
    const highest = Math.max(...known.map(({ degree }) => degree));
    const degrees = Array.from({ length: highest + 1 }, (_, k) => new Option(k, k));
    $('degree').replaceChildren(...degrees);
    this.viewer.set({ degree: Math.min(this.viewer.degree ?? highest, highest) });
    $('sizes').hidden = Boolean(this.viewer.player);
    const [head, body] = [$('sizes').tHead, $('sizes').tBodies[0]];
    head.replaceChildren();
    body.replaceChildren();
    const title = element('tr', '', head);
    if (this.two) {
      element('td', '', title);
      for (const name of 'AB') element('th', name, title).scope = 'col';
    }
    const columns = scenes.map(({ scene }) => bitsOf(scene));
    for (const name of [...Object.keys(ATTRIBUTES), 'other', 'file']) {
      if (name === 'levels' && !columns.some((bits) => bits?.levels)) continue;
      const row = element('tr', '', body);
      element('th', say(name), row).scope = 'row';
      for (const bits of columns) element('td', bits ? number(bits[name], 1) : '', row);
    }
  }

  /** Set the title above the panel, which is visible when the panel is closed. */
  #title(text) {
    $('panel').firstElementChild.textContent = text;
  }

  /** Show that loading is finished, or has failed. */
  loaded() {
    this.#title(say('Scene'));
    $('stop').hidden = true;
    for (const { bar } of this.rows) bar.hidden = true;
  }
}

/** Bits per Gaussian by attribute. */
function bitsOf(scene) {
  if (!scene) return null;
  const per = (bytes) => (8 * bytes) / Math.max(scene.count, 1);
  const found = { other: 0, file: 0 };
  for (const [name, streams] of Object.entries(ATTRIBUTES)) {
    found[name] = per(streams.reduce((sum, stream) => sum + (scene.bytes[stream] ?? 0), 0));
    found.other -= found[name];
  }
  found.file = per(Object.values(scene.bytes).reduce((sum, size) => sum + size, 0));
  found.other += found.file;
  return found;
}
