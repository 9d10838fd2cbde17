// Answers to the page that embeds this one, which asks by `createViewer` of ../embed.js. A call is
// {gsCodec: 1, id, call, value}, its answer {gsCodec: 1, id, result} or {gsCodec: 1, id, error}; an
// event is {gsCodec: 1, event, detail}.
import { stateOf } from './address.js';

const VERSION = 1;

/** Whether a page of this origin may see what this page shows, as pages of its own site may. */
function isTrusted(origin, listed) {
  const isLocal = !location.protocol.startsWith('http'); // from disk, or part of the other page
  return isLocal || [location.origin, ...listed].includes(origin) || listed.includes('*');
}

/** What is shown; another language loads the page again. */
function stateIn(viewer) {
  const { lang, ...state } = viewer.state;
  return state;
}

/** What to show; throws a RangeError if a value is not possible. */
function checked(asked, possible) {
  const given = Object.entries({ ...asked }).filter(([, value]) => value !== undefined);
  const found = stateOf(Object.fromEntries(given), { ...possible, languages: [] });
  for (const [name, value] of given) {
    const isPossible = Object.hasOwn(found, name) && found[name] !== undefined;
    if (!isPossible) throw new RangeError(`${name}: not possible: ${value}`);
  }
  return found;
}

const factsOf = ({ scenes, views, possible, errors }) => ({
  scenes: scenes.map(({ entry: { name }, scene }) => ({
    name,
    count: scene?.count,
    degree: scene?.degree,
    profile: scene?.profile,
  })),
  views: views.map(({ img_name: name }) => name),
  shows: possible.shows,
  ups: possible.ups,
  backgrounds: possible.backgrounds,
  errors: errors.map(({ text }) => text),
});

/**
 * Answer the embedding page, and tell it what changes once it has asked.
 *
 * @param {object} viewer
 * @param {string[]} [listed] origins of other sites that may embed this page; `*` is any
 */
export function answer(viewer, listed = []) {
  if (parent === self) return;
  const ended = new Promise((resolve) => viewer.addEventListener('ended', resolve));
  const calls = {
    hello: () => VERSION,
    facts: () => ended.then(() => factsOf(viewer)),
    state: () => stateIn(viewer),
    set: (asked) => {
      viewer.show(checked(asked, viewer.possible));
      return stateIn(viewer);
    },
    picture: () => viewer.picture(),
  };
  let target; // origin of the page that has asked
  const send = (message) => parent.postMessage({ gsCodec: VERSION, ...message }, target);
  addEventListener('message', async ({ source, origin, data }) => {
    if (source !== parent || data?.gsCodec !== VERSION || !Object.hasOwn(calls, data.call)) return;
    const { id, call, value } = data;
    if (!isTrusted(origin, listed)) {
      const error = `pages of ${origin} may not control this page: gs-codec share --embed`;
      parent.postMessage({ gsCodec: VERSION, id, error }, '*');
      return;
    }
    target = origin === 'null' ? '*' : origin; // 'null' is the origin of files
    try {
      send({ id, result: await calls[call](value) });
    } catch (error) {
      send({ id, error: error.message });
    }
  });
  let asked;
  viewer.addEventListener('changed', () => {
    if (!target) return;
    asked ??= requestAnimationFrame(() => {
      asked = undefined;
      send({ event: 'change', detail: stateIn(viewer) });
    });
  });
  let told = '';
  viewer.addEventListener('told', () => {
    const { message } = viewer.panel;
    if (!target || message.text === told) return;
    told = message.text;
    send({ event: 'message', detail: message });
  });
}
