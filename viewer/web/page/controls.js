// Mouse, touch and keyboard.

/** Radians per pixel. */
const TURN = 0.005;

/** Speed of keys, per second: radians, and movement relative to the distance of the target. */
const [ANGLE, PACE] = [1.2, 0.6];

/** Factor of the flying speed with shift. */
const FASTER = 4;

/** Factor of wheels with ctrl: so browsers report pinches on a touchpad, in small steps. */
const PINCH = 10;

/** Movements of held keys: turn sideways and upwards; move right, down, forward. */
const HELD = {
  ArrowLeft: [1, 0, 0, 0, 0],
  ArrowRight: [-1, 0, 0, 0, 0],
  ArrowUp: [0, 1, 0, 0, 0],
  ArrowDown: [0, -1, 0, 0, 0],
  KeyA: [0, 0, -1, 0, 0],
  KeyD: [0, 0, 1, 0, 0],
  KeyQ: [0, 0, 0, 1, 0],
  KeyE: [0, 0, 0, -1, 0],
  KeyW: [0, 0, 0, 0, 1],
  KeyS: [0, 0, 0, 0, -1],
};

/** The same with shift, which is faster. */
const SHIFTED = {
  ArrowLeft: [0, 0, -1 / FASTER, 0, 0],
  ArrowRight: [0, 0, 1 / FASTER, 0, 0],
  ArrowUp: [0, 0, 0, -1 / FASTER, 0],
  ArrowDown: [0, 0, 0, 1 / FASTER, 0],
};

/** Keys that bring the camera nearer to its target, by what they type. */
const NEARER = { '+': 1, '=': 1, '-': -1 };

/**
 * Control a viewer by mouse, touch and keys on its canvas.
 *
 * @param {HTMLElement} element
 * @param {object} viewer has `pose`, `up`, `focal` (pixels of the page), `moved()`, and
 *   `rest()`, which stops what moves the camera by itself
 * @returns {(right: number, forward: number) => void} flies at shares of the full speed
 */
export function control(element, viewer) {
  const pointers = new Map();

  const shift = (x, y) => {
    const size = viewer.pose.distance / viewer.focal;
    viewer.pose.move(-x * size, -y * size, 0);
  };

  element.addEventListener('pointerdown', (event) => {
    viewer.rest();
    element.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ['pointerup', 'pointercancel']) {
    element.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  element.addEventListener('pointermove', (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [x, y] = [now[0] - before[0], now[1] - before[1]];
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    pointers.set(event.pointerId, now);
    const { pose, up } = viewer;
    if (other) {
      const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]) + 1;
      pose.zoom(apart(before) / apart(now));
      shift(x / 2, y / 2); // each of two fingers moves the point between them by half
    } else if (event.ctrlKey || event.shiftKey || event.buttons & 6) {
      shift(x, y);
    } else {
      pose.orbit(-x * TURN * handed(pose, up), -y * TURN, up);
    }
    viewer.moved();
  });
  element.addEventListener('contextmenu', (event) => event.preventDefault());
  element.addEventListener(
    'wheel',
    (event) => {
      // In an embedded page, the wheel belongs to the outer page until the scene is clicked.
      if (self !== top && !document.hasFocus()) return;
      event.preventDefault();
      viewer.rest();
      const lines = event.deltaY * [1, 30, 300][event.deltaMode] * (event.ctrlKey ? PINCH : 1);
      viewer.pose.zoom(Math.exp(Math.min(Math.max(lines, -300), 300) * 0.0012));
      viewer.moved();
    },
    { passive: false },
  );

  const held = new Map(); // movements by the code of their key
  let stick = [0, 0];
  const isAtRest = () => held.size === 0 && !stick.some(Boolean);
  let last = 0;
  let isFast = false;
  const advance = (now) => {
    const seconds = Math.min(Math.max(now - last, 0) / 1000, 0.1);
    last = now;
    const sum = [0, 0, stick[0] * seconds, 0, stick[1] * seconds, 0];
    for (const movement of held.values()) {
      movement.forEach((value, k) => (sum[k] += value * seconds));
    }
    const { pose, up } = viewer;
    pose.orbit(-sum[0] * ANGLE * handed(pose, up), -sum[1] * ANGLE, up);
    const pace = PACE * pose.distance * (isFast ? FASTER : 1);
    pose.move(...sum.slice(2, 5).map((value) => value * pace));
    pose.zoom(Math.exp(-sum[5] * ANGLE));
    viewer.moved();
  };
  const step = (now) => {
    if (isAtRest()) return;
    advance(now);
    requestAnimationFrame(step);
  };
  const begin = () => {
    viewer.rest();
    if (!isAtRest()) return;
    last = performance.now();
    requestAnimationFrame(step);
  };
  document.addEventListener('keydown', (event) => {
    const { code, key, target } = event;
    isFast = event.shiftKey;
    const nearer = NEARER[key] && [0, 0, 0, 0, 0, NEARER[key]];
    const movement = (isFast && SHIFTED[code]) || nearer || HELD[code];
    if (!movement || event.ctrlKey || event.altKey || event.metaKey) return;
    // Arrow keys belong to the focused element, letters to lists.
    const isElsewhere = target !== element && target !== document.body;
    if (target.tagName === 'SELECT' || target.type === 'number') return;
    if (isElsewhere && code.startsWith('Arrow')) return;
    event.preventDefault();
    begin();
    held.set(code, movement);
  });
  document.addEventListener('keyup', ({ code, key, shiftKey }) => {
    // A key may come and go between two frames.
    if (held.has(code)) advance(performance.now());
    isFast = shiftKey;
    held.delete(code);
    // On a Mac, keys that are released while the command key is held have no event.
    if (key === 'Meta') held.clear();
  });
  addEventListener('blur', () => held.clear());
  return (right, forward) => {
    begin();
    stick = [right, forward];
  };
}

/** Sign that makes a drag to the right turn to the right, for an upright or inverted camera. */
const handed = ({ turn }, up) =>
  turn[1].reduce((sum, value, k) => sum + value * up[k], 0) > 0 ? -1 : 1;
