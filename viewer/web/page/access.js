// The page by keyboard and screen reader.
import { say } from './strings.js';

const $ = (id) => document.getElementById(id);

/** Milliseconds until a change is said, together with others. */
const SOON = 500;

/** The choices of the panel by name, each with its control. */
function choices() {
  const found = new Map();
  for (const control of $('panel').querySelectorAll('select, input:checked, [type=checkbox]')) {
    const [label] = control.labels;
    const group = control.type === 'radio' && control.closest('fieldset');
    if (control.localName === 'select') {
      found.set(label.firstChild.data.trim(), [control.selectedOptions[0]?.text, control]);
    } else if (group) {
      found.set(group.firstElementChild.textContent, [label.textContent.trim(), group]);
    } else {
      found.set(label.textContent.trim(), [control.checked ? say('on') : say('off'), control]);
    }
  }
  return found;
}

/**
 * Say what changes, and let letters be switched off, which speech input may type by accident.
 *
 * @param {EventTarget} viewer
 */
export function accompany(viewer) {
  $('heading').textContent = document.title;
  let known = choices();
  let waiting;
  const settle = () => {
    waiting = undefined;
    const now = choices();
    const changed = [...now].filter(([name, [value, control]]) => {
      // The control in use is spoken by itself.
      return value !== known.get(name)?.[0] && !control.contains(document.activeElement);
    });
    known = now;
    if (changed.length) announce(changed.map(([name, [value]]) => `${name} ${value}`).join(', '));
  };
  viewer.addEventListener('changed', () => {
    waiting ??= setTimeout(settle, SOON);
  });
  viewer.addEventListener('ended', () => {
    known = choices();
    announce([...$('scenes').children].map(({ firstChild }) => firstChild.data).join(', '));
  });
  viewer.addEventListener('told', () => {
    const { text } = viewer.panel.message;
    if (text) announce(text);
  });
  // A clicked scene needs no focus, whose ring would surround the picture at the next key.
  $('view').addEventListener('focus', ({ target }) => {
    if (!target.matches(':focus-visible')) target.blur();
  });
  addEventListener(
    'keydown',
    (event) => {
      const isLetter = event.key.length === 1 && event.key !== ' ';
      if (isLetter && !event.ctrlKey && !event.metaKey && !$('letters').checked) {
        event.stopPropagation();
      }
    },
    { capture: true },
  );
}

/** Let screen readers say a text; the same text is said once. */
function announce(text) {
  if ($('said').textContent !== text) $('said').textContent = text;
}
